"""Step responses of the speed loop, through the compiled card: for a test, and for the plots of ``docs/motion.md``."""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from tests.support.rig import MOTOR, TUNED, Rig

Floats = npt.NDArray[np.float64]
SPEED_DEG_S = TUNED.speed_deg_s
LOAD_AT_S = 0.6
LOAD_NM = 3.0
"""About a tenth of the motor's torque at standstill, and ten times its friction."""


@dataclass(frozen=True)
class Response:
    """Times since the start of the motor, its true speed, and the duty."""

    time_s: Floats
    speed_deg_s: Floats
    duty: Floats

    def settled_s(self, since_s: float, band: float = 0.01) -> float:
        """Time after ``since_s`` at which the speed, averaged over 10 ms, enters the band around its end for good."""
        width = round(0.01 / (self.time_s[1] - self.time_s[0]))
        smooth = np.convolve(self.speed_deg_s, np.ones(width) / width, "same")
        part = (self.time_s >= since_s) & (self.time_s < self.time_s[-1] - 0.01)
        outside = np.flatnonzero(part & (np.abs(smooth - SPEED_DEG_S) > band * SPEED_DEG_S))
        return float(self.time_s[outside[-1]] - since_s) if len(outside) else 0.0


def respond(bridge: str = "sign-magnitude") -> Response:
    """From standstill to 300 deg/s at 3000 deg/s2; after 0.6 s a load comes on."""
    rig = Rig(replace(TUNED, bridge=bridge), parameters=replace(MOTOR, supply_ripple=0.02))
    rig.start(arm=False)
    begin = len(rig.samples)
    rig.run(LOAD_AT_S)
    rig.motor.parameters = replace(rig.motor.parameters, load_nm=LOAD_NM)
    rig.run(0.6)
    assert rig.safety().fault(armed=False) is None
    rig.close()
    samples = rig.samples[begin:]
    times = np.array([sample.time_s for sample in samples])
    return Response(
        times - times[0],
        np.array([sample.speed_deg_s for sample in samples]),
        np.array([sample.duty for sample in samples]),
    )
