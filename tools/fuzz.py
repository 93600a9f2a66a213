"""Fuzzing of what reads files of others: pictures (`load_picture`), drawings (`read_svg`, `check_untrusted`), and
pictures drawn as artwork, written and read back.

    python tools/fuzz.py --inputs 100000

Every input must be read, with values in range, or be refused with an error of ours of one line, within five seconds.
Any other exception, a crash of the process, or a hang is a find: its bytes are kept in tests/fuzz/, where a test of
the ordinary suite reads them ever after, and the exit code is 1.
"""

from __future__ import annotations

import argparse
import hashlib
import multiprocessing
import sys
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path

FINDS = Path(__file__).resolve().parents[1] / "tests" / "fuzz"
TARGETS = ("picture", "drawing", "artwork")
MOST_SECONDS = 5.0
MOST_CHARACTERS = 1000
MAX_PIXELS = 2_000_000
_BATCH = 200


def try_input(target: str, data: bytes) -> str:
    """ "read" or "refused"; raises whatever must not happen."""
    import numpy as np

    from cubicsplat_cli.errors import InputError
    from cubicsplat_cli.files.load import load_picture
    from cubicsplat_cli.svg.scene_reader import read_svg
    from cubicsplat_cli.svg.untrusted import check_untrusted

    if target == "artwork":
        return _draw(data)
    outcomes = set()
    readers = {"load_picture": lambda: load_picture(data, max_pixels=MAX_PIXELS)}
    if target == "drawing":
        readers = {"read_svg": lambda: read_svg(data), "check_untrusted": lambda: check_untrusted(data, "x.svg")}
    for name, reader in readers.items():
        try:
            found = reader()
        except InputError as error:
            text = str(error)
            # check_untrusted quotes names of the file whole; the command cuts what it prints.
            if "\n" in text or (len(text) > MOST_CHARACTERS and name != "check_untrusted"):
                raise AssertionError(f"an error that is no line: {text[:2000]!r}") from error
            outcomes.add("refused")
            continue
        if target == "picture":
            channels = found.target()
            if not (np.isfinite(channels).all() and channels.min() >= 0 and channels.max() <= 1):
                raise AssertionError("values out of range")
        elif hasattr(found, "validate"):
            found.validate()
        outcomes.add("read")
    return "read" if "read" in outcomes else "refused"


def _draw(data: bytes) -> str:
    """A picture drawn as artwork, whose file must be one of ours; "refused" where nothing is left to draw."""
    from cubicsplat_cli.artwork.vectorize import draw
    from cubicsplat_cli.files.load import load_picture
    from cubicsplat_cli.svg.drawing_reader import read_drawing
    from cubicsplat_cli.svg.drawing_writer import write_drawing
    from cubicsplat_cli.svg.scene_reader import read_svg

    drawing = draw(load_picture(data).target())
    text = write_drawing(drawing, title="x", comment="x")
    written = read_drawing(text).shapes
    if not written:
        return "refused"
    read_svg(text).validate()
    return "read"


def _work(pipe: Connection, target: str, seed: int, first: int, last: int) -> None:
    """Try inputs first..last-1; says which one is next before, and now and then how they went."""
    sys.path.insert(0, str(Path(__file__).parent))
    from fuzz_inputs import make_input

    warnings.simplefilter("ignore")
    make_input(target, 0, seed)
    try_input(target, b"")  # whose imports are not on any input's clock
    counts: Counter[str] = Counter()
    for number in range(first, last):
        data = make_input(target, number, seed)
        pipe.send(("next", number))
        try:
            counts[try_input(target, data)] += 1
        except Exception:
            pipe.send(("find", (number, traceback.format_exc())))
        if number % _BATCH == 0 or number == last - 1:
            pipe.send(("counts", counts))
            counts = Counter()
    pipe.send(("end", None))


class Campaign:
    """Inputs of one target, tried in a process that is watched.

    finds: folder for the bytes of finds. most_seconds: for one input. work: tries inputs, in the process.
    """

    def __init__(
        self,
        target: str,
        seed: int,
        inputs: int,
        finds: Path = FINDS,
        most_seconds: float = MOST_SECONDS,
        work: Callable[[Connection, str, int, int, int], None] = _work,
    ) -> None:
        self.target, self.seed, self.inputs = target, seed, inputs
        self.folder, self.most_seconds, self.work = finds, most_seconds, work
        self.counts: Counter[str] = Counter()
        self.finds: list[str] = []

    def run(self) -> None:
        """All of them, in a new process after each that ended one."""
        first = 0
        while first < self.inputs:
            first = self._run_from(first)

    def _run_from(self, first: int) -> int:
        """The number to go on from."""
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe(duplex=False)
        arguments = (theirs, self.target, self.seed, first, self.inputs)
        process = context.Process(target=self.work, args=arguments, daemon=True)
        process.start()
        theirs.close()
        number, since = first - 1, time.monotonic()
        try:
            while True:
                # The first message comes after the imports.
                limit = 120.0 if number < first else self.most_seconds
                if not ours.poll(max(0.0, since + limit - time.monotonic())):
                    self._find(number, f"took more than {limit:g} s")
                    return max(number, first) + 1
                kind, content = ours.recv()
                if kind == "next":
                    number, since = content, time.monotonic()
                elif kind == "find":
                    self._find(*content)
                elif kind == "counts":
                    self.counts += content
                else:
                    return self.inputs
        except EOFError:
            process.join()
            self._find(number, f"the process died with exit code {process.exitcode}")
            return max(number, first) + 1
        finally:
            process.kill()
            process.join()

    def _find(self, number: int, what: str) -> None:
        from fuzz_inputs import make_input

        data = make_input(self.target, max(0, number), self.seed)
        name = f"{self.target}-{hashlib.sha256(data).hexdigest()[:12]}"
        self.folder.mkdir(parents=True, exist_ok=True)
        (self.folder / name).write_bytes(data)
        self.finds.append(name)
        print(f"FIND {name} (input {number} of seed {self.seed}): {what}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--inputs", type=int, default=100_000, help="how many, over all targets [100000]")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--target", choices=TARGETS, help="only this one")
    options = parser.parse_args()
    sys.path.insert(0, str(Path(__file__).parent))
    targets = [options.target] if options.target else list(TARGETS)
    started, finds, tried = time.monotonic(), 0, 0
    for target in targets:
        campaign = Campaign(target, options.seed, -(-options.inputs // len(targets)))
        campaign.run()
        finds += len(campaign.finds)
        tried += sum(campaign.counts.values()) + len(campaign.finds)
        counts = ", ".join(f"{count} {outcome}" for outcome, count in sorted(campaign.counts.items()))
        print(f"{target}: {counts}, {len(campaign.finds)} finds", flush=True)
    print(f"{tried} inputs in {time.monotonic() - started:.0f} s, {finds} finds")
    sys.exit(1 if finds else 0)


if __name__ == "__main__":
    main()
