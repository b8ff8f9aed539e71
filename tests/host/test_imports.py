"""The host package runs with nothing but what it declares, and starts fast."""

import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

HOST = Path(__file__).parents[2] / "host"

BLOCKED = """
import sys

class Blocker:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {
            "amaranth", "gateware", "sim", "boards", "cv2", "scipy", "matplotlib", "PIL", "mcap", "rosbags", "zstandard"
        }:
            raise ModuleNotFoundError(f"blocked: {name}", name=name)

sys.meta_path.insert(0, Blocker())
"""


def run(script: str) -> str:
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", textwrap.dedent(script)],
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


def modules() -> list[str]:
    paths = sorted((HOST / "magtrak").rglob("*.py"))
    names = [".".join(path.relative_to(HOST).with_suffix("").parts) for path in paths]
    return [name.removesuffix(".__init__") for name in names if not name.endswith("__main__")]


def test_every_module_imports_without_extras_and_gateware() -> None:
    run(BLOCKED + f"import importlib\nfor name in {modules()!r}: importlib.import_module(name)")


def test_the_blocker_blocks() -> None:
    with pytest.raises(AssertionError, match=r"blocked: amaranth"):
        run(BLOCKED + "import amaranth")


def test_the_protocol_needs_the_standard_library_alone() -> None:
    out = run("""
        import sys
        before = set(sys.modules)
        import magtrak.protocol.document
        print(sorted({name.split(".")[0] for name in set(sys.modules) - before} - sys.stdlib_module_names))
    """)
    assert out.strip() == "['magtrak']"


def test_help_loads_nothing_heavy() -> None:
    out = run("""
        import sys, contextlib
        sys.argv = ["magtrak-recv", "--help"]
        from magtrak.cli.recv import main
        with contextlib.suppress(SystemExit):
            main()
        print([name for name in ("numpy", "serial", "matplotlib") if name in sys.modules])
    """)
    assert "--calibration" in out
    assert out.splitlines()[-1] == "[]"
