"""Runs the benchmarks, prints a table, writes ``build/bench.json``."""

import dataclasses
import importlib
import json
import pkgutil
import platform
import sys
from pathlib import Path

import tests.bench as package

OUTPUT = Path(__file__).resolve().parents[2] / "build" / "bench.json"


def main(names: list[str]) -> None:
    known = [module.name for module in pkgutil.iter_modules(package.__path__) if not module.name.startswith("_")]
    unknown = sorted(set(names) - set(known))
    if unknown:
        raise SystemExit(f"bench: no benchmark is called {', '.join(unknown)}; there are {', '.join(known)}.")
    rows = []
    for name in names or known:
        print(f"\n{name}")
        print(f"{'':2}{'':62} {'ours':>12} {'peer':>12} {'ratio':>8}  unit")
        for figure in importlib.import_module(f"tests.bench.{name}").run():
            peer = "" if figure.peer_value is None else f"{figure.peer_value:.4g}"
            ratio = "" if figure.ratio is None else f"{figure.ratio:.3g}"
            what = figure.what + (f" | {figure.peer}" if figure.peer else "")
            verdict = "" if figure.met is None else f"  [{figure.goal}: {'met' if figure.met else 'NOT MET'}]"
            print(f"  {what:62} {figure.value:12.4g} {peer:>12} {ratio:>8}  {figure.unit}{verdict}", flush=True)
            rows.append({"bench": name, **dataclasses.asdict(figure), "ratio": figure.ratio})
    OUTPUT.parent.mkdir(exist_ok=True)
    OUTPUT.write_text(
        json.dumps({"machine": platform.machine(), "python": platform.python_version(), "figures": rows}, indent=1)
    )


main(sys.argv[1:])
