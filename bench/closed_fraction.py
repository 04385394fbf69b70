#!/usr/bin/env python3
"""Recomputes the gap numbers of a diagnosis from its predictions, independently of the program that made them.

    python3 bench/closed_fraction.py DIAGNOSIS_DIR

Reads predictions.parquet and diagnosis.json, prints gap before, gap after and closed fraction beside the stated ones, and
ends with 1 when the closed fraction differs by more than 0.01. Needs numpy and pyarrow. The noise floor is taken from
diagnosis.json: it needs the bogies' windows, which are not in the file.
"""
import json
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as parquet

TOLERANCE = 0.01


def ratio(rows, measured, model):
    """RMS of (measured - model) over RMS of measured, over all held-out passages."""
    residual = sum(float(np.sum((np.asarray(m) - np.asarray(p)) ** 2)) for m, p in zip(rows[measured], rows[model]))
    return residual / sum(float(np.sum(np.asarray(m) ** 2)) for m in rows[measured])


def main(directory):
    rows = parquet.read_table(directory / "predictions.parquet").to_pydict()
    stated = json.loads((directory / "diagnosis.json").read_text())
    gap = {}
    for model in ("before", "after"):
        squares = ratio(rows, "measured_m", f"{model}_m") + ratio(rows, "measured_m_s2", f"{model}_m_s2")
        gap[model] = (squares / 2) ** 0.5
    floor = stated["gap"]["noise_floor"]
    closed = 0.0
    if stated["effects"] and gap["before"] > floor:
        closed = (gap["before"] - gap["after"]) / (gap["before"] - floor)
    for name, value in (("before", gap["before"]), ("after", gap["after"]), ("closed_fraction", closed)):
        print(f"{name:16} {value:.6f}  stated {stated['gap'][name]:.6f}")
    return 0 if abs(closed - stated["gap"]["closed_fraction"]) <= TOLERANCE else 1


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    sys.exit(main(Path(sys.argv[1])))
