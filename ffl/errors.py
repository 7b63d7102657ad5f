"""The two ways a command can fail, and nothing else."""


class InputError(ValueError):
    """Bad input: the message is one line that says what, where and how to mend (exit code 2)."""


class WorkError(RuntimeError):
    """Sound input, but the work could not be completed (exit code 1); what is done stays on disk."""
