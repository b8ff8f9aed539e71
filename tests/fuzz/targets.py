"""Coverage-guided fuzzing (Atheris, libFuzzer) of whatever reads other people's bytes.

``python -m tests.fuzz.targets decoder|settings|calibration|recording [options of libFuzzer]``, such as ``-runs=100000``
or ``-max_total_time=60``. A crash is written to ``build/fuzz``, with the bytes that made it.
"""

import json
import os
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["magtrak"]):
    import numpy as np

    from magtrak import protocol
    from magtrak.calibration import Calibration
    from magtrak.camera import BrownConrady
    from magtrak.errors import CalibrationError, MagtrakError, SettingsError
    from magtrak.frames import DamagedFrameError, decode_frame
    from magtrak.protocol import Packet, PacketType, frame_packet
    from magtrak.settings_file import PRESETS, load_settings, settings_text
    from magtrak.snapshot import DamagedPieceError, decode_piece
    from magtrak.stream import PacketStream
    from tests.fuzz.damage import pool
    from tests.support.calibrations import example_calibration

OUT = Path(__file__).resolve().parents[2] / "build" / "fuzz"
_FOLDER = Path(tempfile.mkdtemp(prefix="magtrak-fuzz-"))
"""For the files that targets read."""


def decoder(data: bytes) -> None:
    """Bytes as a stream, however they are cut; and as the content of packets, which no CRC protects here."""
    cut = data[0] if data else 0
    whole, pieces = PacketStream(), PacketStream()
    got = whole.feed(data)
    assert got == pieces.feed(data[:cut]) + pieces.feed(data[cut:])
    now = whole.statistics()
    assert now == pieces.statistics()
    assert len(data) == now.bytes and now.packets == len(got)
    assert now.damaged + now.packets <= data.count(0)
    # What is intact comes out whatever came before it, once a delimiter has.
    packet = Packet(PacketType.FRAME, 7, data)
    assert pieces.feed(b"\0" + frame_packet(packet))[-1:] == [packet]
    _contents(data)


def _contents(payload: bytes) -> None:
    try:
        frame = decode_frame(payload)
    except DamagedFrameError:
        pass
    else:
        rows = frame.rows
        size = {protocol.RowForm.COMPACT: protocol.COMPACT_ROW.size, protocol.RowForm.FULL: protocol.FULL_ROW.size}
        form = protocol.RowForm(frame.header["form"])
        edges = len(frame.edges)
        assert len(payload) == protocol.FRAME.size + edges * protocol.EDGE.size + len(rows) * size[form]
        assert np.isfinite(rows.column_px).all() and (rows.column_px >= 0).all() and (rows.column_px < 4096).all()
        assert (np.diff(frame.row_times) >= 0).all()
    try:
        piece = decode_piece(payload)
    except DamagedPieceError:
        return
    assert piece.pixels.nbytes == len(payload) - protocol.SNAPSHOT.size


def settings(data: bytes) -> None:
    """A settings file: refused in one sentence, or every register takes what comes of it."""
    path = _FOLDER / "x.toml"
    path.write_bytes(data)
    try:
        chosen = load_settings(str(path))
        values = chosen.register_values(50e6)
    except SettingsError as error:
        assert "\n" not in str(error).strip()
        return
    for name, words in [*values, *chosen.tables()]:
        entry = protocol.register(name)
        assert len(words) == entry.words
        assert all(entry.decode(entry.encode(word)) == word for word in words)


def calibration(data: bytes) -> None:
    """A calibration file: refused in one sentence, or kept whole when written, and good for rays."""
    path = _FOLDER / "x.json"
    path.write_bytes(data)
    try:
        loaded = Calibration.load(path)
    except CalibrationError as error:
        assert "\n" not in str(error).strip()
        return
    loaded.save(path)
    again = Calibration.load(path)
    assert again.as_dict() == loaded.as_dict()
    camera = loaded.camera.build()
    u, v = np.array([0.0, loaded.camera.width - 1.0]), np.array([0.0, loaded.camera.height - 1.0])
    rays = camera.ray(u, v)
    assert rays.shape == (2, 3) and np.isfinite(rays).all()
    if isinstance(camera, BrownConrady):
        assert (rays[:, 2] > 0).all()


def recording(data: bytes) -> None:
    """A recording: refused in one sentence, or repaired and readable to its end."""
    from magtrak.replay import Replay, open_recording

    path = _FOLDER / "x.mcap"
    path.write_bytes(data)
    try:
        opened = open_recording(path)
    except MagtrakError as error:
        assert "\n" not in str(error).strip()
        return
    for _ in Replay(opened).frames():
        pass


def _seeds(name: str) -> list[bytes]:
    match name:
        case "decoder":
            packets = pool(1)[:40]
            return [packet.payload for packet in packets] + [b"".join(map(frame_packet, packets[:5]))]
        case "settings":
            return [settings_text(preset).encode() for preset in PRESETS]
        case "calibration":
            return [json.dumps(example_calibration()).encode()]
        case _:
            from magtrak.reader import Chunk
            from magtrak.recording import Recorder

            path = _FOLDER / "seed.mcap"
            recorder = Recorder(path, json.dumps(example_calibration()), settings_text("green"), {"angle": "rows"})
            recorder.event("open", port="x")
            recorder.event("start", generation=0, clock_hz=50_000_000)
            recorder.wire(Chunk(b"".join(map(frame_packet, pool(1)[:20])), 1.0))
            recorder.event("end", frames=3)
            recorder.close()
            return [path.read_bytes(), path.read_bytes()[:-200]]


TARGETS: dict[str, Callable[[bytes], None]] = {one.__name__: one for one in (decoder, settings, calibration, recording)}


def main() -> None:
    if len(sys.argv) < 2 or sys.argv[1] not in TARGETS:
        raise SystemExit(f"usage: python -m tests.fuzz.targets {'|'.join(TARGETS)} [libFuzzer options]")
    name = sys.argv[1]
    corpus = _FOLDER / "corpus"
    corpus.mkdir()
    for number, seed in enumerate(_seeds(name)):
        (corpus / f"seed{number}").write_bytes(seed)
    OUT.mkdir(parents=True, exist_ok=True)
    options = [f"-artifact_prefix={OUT}{os.sep}{name}-", "-max_len=8192", "-print_final_stats=1"]
    atheris.Setup([sys.argv[0], str(corpus), *options, *sys.argv[2:]], TARGETS[name])
    atheris.Fuzz()


if __name__ == "__main__":
    main()
