"""The compiled card with a motor and an encoder that can be broken, in card time, without a serial port."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from magtrak import protocol
from magtrak.motor import Motor as MotorSettings
from magtrak.protocol import Deframer, PacketType, register
from magtrak.safety import Safety
from magtrak.settings import Encoder, LaserSwitch, Settings
from sim.core import INTERLOCK, PIN, SimulatedCore
from sim.encoder import Event, Flaws, Signal
from sim.motor import Motor, MotorParameters

CLOCK_HZ = 2_000_000
COUNTS = 1024
SLICE_S = 2e-4
PING_S = 0.05

MOTOR = MotorParameters(
    supply_v=34, resistance_ohm=4, torque_constant_nm_a=4, inertia_kg_m2=0.21, viscous_nm_s=0.2, friction_nm=0.3
)
TUNED = MotorSettings(
    mode="speed",
    speed_deg_s=300.0,
    acceleration_deg_s2=3000.0,
    kp=0.0108,
    ki=0.173,
    feed_forward=0.00216,
    friction=0.00882,
)

Alter = Callable[[float, Sequence[Event]], Sequence[Event]]


@dataclass
class Sample:
    """One slice: its end, speed of the motor (deg/s), and what the pins did."""

    time_s: float
    speed_deg_s: float
    duty: float
    laser: bool
    braked: bool


class Rig:
    """A card whose motor turns, whose host pings.

    Parameters
    ----------
    motor : what the card is told of it
    laser : likewise
    parameters : of the motor itself
    alter : what the wires do to the encoder's events, given the time of a slice's start; may be exchanged
    angle_rad : where the motor stands at first
    """

    def __init__(
        self,
        motor: MotorSettings = TUNED,
        laser: LaserSwitch | None = None,
        parameters: MotorParameters = MOTOR,
        alter: Alter | None = None,
        angle_rad: float = -0.2,
        flaws: Flaws | None = None,
    ) -> None:
        self.core = SimulatedCore(CLOCK_HZ, 1.2e6)
        self.motor = Motor(parameters, angle_rad, COUNTS, flaws=flaws)
        self.alter = alter
        self.pinging = True
        self.samples: list[Sample] = []
        self._duty = 0.0
        self._pinged_s = 0.0
        self._deframer = Deframer()
        self._sequence = 0
        levels = [(0, signal, level) for signal, level in self.motor.levels().items()]
        self.core.pins(np.array([*levels, (0, INTERLOCK, 1)], PIN))
        self.settings = Settings(
            motor=motor, laser=laser or LaserSwitch(delay_s=0.01), encoder=Encoder(counts_per_turn=COUNTS)
        )

    @property
    def time_s(self) -> float:
        return self.core.clock / CLOCK_HZ

    def start(self, *, arm: bool = True) -> None:
        """Settings, laser, motor; as ``Card.apply`` and ``Card.start`` have it."""
        for name, words in self.settings.register_values(CLOCK_HZ):
            self.write(name, words[0])
        if arm:
            self.write("laser_arm", protocol.LASER_KEY)
        self.write("motor_duty", self.settings.motor.duty_word())
        self.write("motor_mode", self.settings.motor.mode_word())

    def run(self, seconds: float, *, until: Callable[[Sample], bool] | None = None) -> float | None:
        """Run on; the time at which ``until`` was true first, where it was."""
        end = self.time_s + seconds
        while self.time_s < end - 1e-9:
            sample = self._slice()
            if until is not None and until(sample):
                return sample.time_s
        return None

    def write(self, name: str, value: int) -> None:
        entry = register(name)
        self._command(PacketType.WRITE, entry.address, entry.encode(value))

    def read(self, name: str) -> int:
        entry = register(name)
        return entry.decode(self._command(PacketType.READ, entry.address, 0))

    def safety(self) -> Safety:
        return Safety.of(self.read("safety"))

    def set_pin(self, pin: int, level: int) -> None:
        self.core.pins(np.array([(self.core.clock, pin, level)], PIN))

    def _command(self, kind: PacketType, address: int, value: int) -> int:
        payload = protocol.COMMAND.pack({"address": address, "value": value})
        self._sequence += 1
        self.core.send(protocol.frame_packet(protocol.Packet(kind, self._sequence, payload)))
        for _ in range(50):
            self._slice()
            for packet in self._deframer.feed(self.core.receive()):
                answer = protocol.ANSWER.unpack(packet.payload)
                if answer["to"] == self._sequence:
                    assert answer["code"] in (0, 1), (address, value, answer)
                    return answer["value"]
        raise TimeoutError(f"no answer to {kind} of 0x{address:04X}")

    def _slice(self) -> Sample:
        begin = self.time_s
        if self.pinging and begin - self._pinged_s > PING_S:
            self._pinged_s = begin
            payload = protocol.COMMAND.pack({"address": register("safety").address, "value": 0})
            self.core.send(protocol.frame_packet(protocol.Packet(PacketType.READ, 0xFFFF, payload)))
        events: Sequence[Event] = self.motor.advance(begin + SLICE_S, self._duty)
        if self.alter is not None:
            events = self.alter(begin, events)
        changes = sorted((round(e.time_s * CLOCK_HZ), int(e.signal), e.level) for e in events)
        self.core.pins(np.array([(max(clock, self.core.clock), *rest) for clock, *rest in changes], PIN))
        out = self.core.run(round((begin + SLICE_S) * CLOCK_HZ))
        self._duty = out.drive
        speed = float(np.degrees(self.motor.speed_rad_s))
        sample = Sample(self.time_s, speed, out.drive, out.laser, out.braked > 0)
        self.samples.append(sample)
        return sample

    def close(self) -> None:
        self.core.close()


def seize(rig: Rig) -> None:
    """The rotor is stuck from now on."""
    rig.motor.parameters = replace(rig.motor.parameters, friction_nm=1e6)


def cut(signal: Signal, level: int = 1) -> Alter:
    """A wire is broken: the pin is pulled up."""
    done = False

    def alter(begin: float, events: Sequence[Event]) -> Sequence[Event]:
        nonlocal done
        first = [] if done else [Event(begin, signal, level)]
        done = True
        return [*first, *(event for event in events if event.signal is not signal)]

    return alter


def swapped(_: float, events: Sequence[Event]) -> Sequence[Event]:
    """A and B exchanged."""
    other = {Signal.A: Signal.B, Signal.B: Signal.A, Signal.INDEX: Signal.INDEX}
    return [event._replace(signal=other[event.signal]) for event in events]


def without_index(_: float, events: Sequence[Event]) -> Sequence[Event]:
    return [event for event in events if event.signal is not Signal.INDEX]


def second_index(half_turn_s: float) -> Alter:
    """A second pulse, half a turn after each."""
    due: list[float] = []

    def alter(begin: float, events: Sequence[Event]) -> Sequence[Event]:
        due.extend(e.time_s + half_turn_s for e in events if e.signal is Signal.INDEX and e.level)
        more = [t for t in due if t < begin + SLICE_S]
        due[:] = [t for t in due if t >= begin + SLICE_S]
        pulses = [Event(t, Signal.INDEX, 1) for t in more] + [Event(t + 50e-6, Signal.INDEX, 0) for t in more]
        return [*events, *pulses]

    return alter


def noise(signals: Sequence[Signal], levels: dict[Signal, int], seed: int) -> Alter:
    """Bursts longer than the glitch filter on some wires, together where there are several."""
    rng = np.random.default_rng(seed)

    def alter(begin: float, events: Sequence[Event]) -> Sequence[Event]:
        for event in events:
            levels[event.signal] = event.level
        out = list(events)
        if rng.random() < 0.2 and not events:
            at = begin + 20e-6
            out += [Event(at, signal, 1 - levels[signal]) for signal in signals]
            out += [Event(at + 5e-6, signal, levels[signal]) for signal in signals]
        return out

    return alter
