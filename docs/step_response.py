"""Draws ``docs/step_response.png``: the speed loop on the compiled card. ``python -m docs.step_response``."""

from pathlib import Path

import matplotlib

matplotlib.use("agg")
import matplotlib.pyplot as plt

from tests.support.step_response import LOAD_AT_S, LOAD_NM, SPEED_DEG_S, respond


def main() -> None:
    response = respond()
    figure, (top, bottom) = plt.subplots(2, 1, sharex=True, figsize=(7, 4.5), height_ratios=[2, 1])
    top.axhspan(0.99 * SPEED_DEG_S, 1.01 * SPEED_DEG_S, color="0.9", label="1 % band")
    top.plot(response.time_s, response.speed_deg_s, lw=0.8, color="tab:green")
    top.set_ylabel("speed, deg/s")
    top.annotate(f"load of {LOAD_NM:g} Nm", (LOAD_AT_S, SPEED_DEG_S * 0.75), ha="center")
    top.legend(loc="lower right")
    bottom.plot(response.time_s, response.duty, lw=0.5, color="tab:blue")
    bottom.set_ylabel("duty")
    bottom.set_xlabel("time, s")
    figure.tight_layout()
    figure.savefig(Path(__file__).with_name("step_response.png"), dpi=90)


if __name__ == "__main__":
    main()
