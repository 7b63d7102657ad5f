"""A learned feedforward as one C header without dependencies."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ffl.bases.friction import STANDS

if TYPE_CHECKING:
    from ffl.campaign.export import Realisation, Section

WRITTEN = "Written by ffl export. */"  # how the first line ends
TYPES = """\
typedef struct { double a[4], b[2], c[2], d, gain[2], rest[2]; } ffl_section;
typedef struct { double positive, negative, velocity; } ffl_friction;
"""

BODY = """\
static double ffl_at(const double *r, int n, int t) {
  return r[t < 0 ? 0 : t >= n ? n - 1 : t];
}

static double ffl_velocity(const double *r, int n, int t) {
  return (ffl_at(r, n, t + 1) - ffl_at(r, n, t - 1)) / (2.0 * FFL_SAMPLE_TIME);
}

static void ffl_chain(const ffl_section *s, int sections, const double *r, double *f, int n,
                      int backwards) {
  double x[FFL_MOST_SECTIONS][2];
  int i, k;
  if (n < 1) return;
  for (k = 0; k < sections; k++) {
    x[k][0] = s[k].rest[0] * r[backwards ? n - 1 : 0];
    x[k][1] = s[k].rest[1] * r[backwards ? n - 1 : 0];
  }
  for (i = 0; i < n; i++) {
    int t = backwards ? n - 1 - i : i;
    double v = r[t];
    for (k = 0; k < sections; k++) {
      double x0 = x[k][0], x1 = x[k][1];
      double w = s[k].c[0] * x0 + s[k].c[1] * x1 + s[k].d * v;
      x[k][0] = s[k].a[0] * x0 + s[k].a[1] * x1 + s[k].b[0] * v;
      x[k][1] = s[k].a[2] * x0 + s[k].a[3] * x1 + s[k].b[1] * v;
      if (backwards) { x0 = x[k][0]; x1 = x[k][1]; }
      f[t] += s[k].gain[0] * x0 + s[k].gain[1] * x1;
      v = w;
    }
  }
}

/* f: feedforward of n samples for the reference r of n samples, which is known beforehand. */
static void ffl_feedforward(const double *r, double *f, int n) {
  double least = 0.0; /* speed up to which the reference stands, but for rounding */
  int t, k;
  for (t = 0; t < n; t++) {
    double v = FFL_FRICTIONS ? FFL_STANDS * ffl_velocity(r, n, t) : 0.0;
    least = v > least ? v : -v > least ? -v : least;
  }
  for (t = 0; t < n; t++) {
    f[t] = 0.0;
    for (k = 0; k < FFL_TAPS; k++) f[t] += ffl_gain[k] * ffl_at(r, n, t - ffl_delay[k]);
    for (k = 0; k < FFL_FRICTIONS; k++) {
      double v = ffl_velocity(r, n, t);
      double limit = ffl_frictions[k].velocity;
      double sign = limit > 0.0 ? v / limit : (v > least) - (v < -least);
      sign = sign > 1.0 ? 1.0 : sign < -1.0 ? -1.0 : sign;
      f[t] += sign * (sign > 0.0 ? ffl_frictions[k].positive : ffl_frictions[k].negative);
    }
  }
  ffl_chain(ffl_forwards, FFL_FORWARDS, r, f, n, 0);
  ffl_chain(ffl_backwards, FFL_BACKWARDS, r, f, n, 1);
}
"""


def _numbers(values: object) -> str:
    return ", ".join(repr(float(value)) for value in np.ravel(np.asarray(values)))


def _array(name: str, sections: tuple[Section, ...]) -> str:
    rows = [
        f"  {{{{{_numbers(s.a)}}}, {{{_numbers(s.b)}}}, {{{_numbers(s.c)}}}, {s.d!r}, "
        f"{{{_numbers(s.gain)}}}, {{{_numbers(s.rest)}}}}},"
        for s in sections
    ] or ["  {{0, 0, 0, 0}, {0, 0}, {0, 0}, 0, {0, 0}, {0, 0}},"]
    return f"static const ffl_section {name}[] = {{\n" + "\n".join(rows) + "\n};\n"


def c_header(realisation: Realisation, told: str) -> str:
    """`ffl_feedforward(r, f, n)` with the learned numbers, every digit kept."""
    r = realisation
    frictions = [
        f"{{{f['level_positive']!r}, {f['level_negative']!r}, {f['velocity']!r}}}"
        for f in r.friction
    ] or ["{0, 0, 0}"]
    most = max(len(r.forwards), len(r.backwards), 1)
    return "\n".join(
        [
            f"/* Learned feedforward: {told}. {WRITTEN}",
            "#ifndef FFL_FEEDFORWARD_H",
            "#define FFL_FEEDFORWARD_H",
            f"enum {{ FFL_TAPS = {len(r.delays)}, FFL_FORWARDS = {len(r.forwards)}, "
            f"FFL_BACKWARDS = {len(r.backwards)}, FFL_FRICTIONS = {len(r.friction)}, "
            f"FFL_MOST_SECTIONS = {most} }};",
            f"#define FFL_SAMPLE_TIME {r.sample_time!r}",
            f"#define FFL_STANDS {STANDS!r}",
            TYPES,
            f"static const int ffl_delay[] = {{{', '.join(map(str, r.delays)) or '0'}}};",
            f"static const double ffl_gain[] = {{{_numbers(r.gains) or '0'}}};",
            f"static const ffl_friction ffl_frictions[] = {{{', '.join(frictions)}}};",
            _array("ffl_forwards", r.forwards),
            _array("ffl_backwards", r.backwards),
            BODY,
            "#endif",
            "",
        ]
    )
