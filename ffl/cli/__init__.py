"""The command line: thin verbs that parse, call and print; everything heavy is imported late."""

from __future__ import annotations

import os
import sys

# One thread in linear algebra: the sums then come out the same in every process, and processes
# (--jobs) are the better use of the cores. A user's own setting stands.
for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

# The verbs add themselves to the app, in the order in which --help shows them.
from ffl.cli import learning, identification, challenge  # noqa: E402, F401  # isort: skip
from ffl.cli.app import app  # noqa: E402
from ffl.cli.interrupts import give_lost_interrupts_again  # noqa: E402
from ffl.errors import InputError, WorkError  # noqa: E402

INTERRUPTED = 130


def _fail(message: str, code: int) -> int:
    print(" ".join(f"ffl: {message}".split()), file=sys.stderr)
    return code


def execute(args: list[str]) -> int:
    """Runs one command line; returns its exit code: 0 done, 1 not completed, 2 bad input."""
    import warnings

    warnings.simplefilter("ignore")  # stderr is for the one line that the user can act on
    try:
        code = app(args=args or ["--help"], prog_name="ffl", standalone_mode=False)
        sys.stdout.flush()
        if code == INTERRUPTED:  # the parser's way of saying Ctrl-C
            raise KeyboardInterrupt
        return code if isinstance(code, int) else 0
    except InputError as error:
        return _fail(str(error), 2)
    except WorkError as error:
        return _fail(str(error), 1)
    except KeyboardInterrupt:
        return _fail(
            "interrupted: what was complete stays on disk, and nothing is half-written", INTERRUPTED
        )
    except BrokenPipeError:  # the reader has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except SystemExit as error:  # the parser's own way out when the reader of stdout has gone
        return 0 if isinstance(error.__context__, BrokenPipeError) else int(error.code or 0)
    except OSError as error:
        bad = isinstance(
            error, (PermissionError, FileNotFoundError, IsADirectoryError, NotADirectoryError)
        )
        return _fail(f"{error.filename or 'file'}: {error.strerror or error}", 2 if bad else 1)
    except Exception as error:
        if hasattr(error, "format_message"):  # a usage error of the parser
            context = getattr(error, "ctx", None)
            command = context.command_path if context is not None else "ffl"
            return _fail(f"{error.format_message().rstrip('.')}. See '{command} --help'.", 2)
        if os.environ.get("FFL_TRACEBACK"):
            raise
        return _fail(
            f"internal error, {type(error).__name__}: {error} (FFL_TRACEBACK=1 shows where)", 1
        )


def main() -> None:
    give_lost_interrupts_again()
    sys.exit(execute(sys.argv[1:]))
