"""The command line of the demonstration."""

from __future__ import annotations

import argparse
import signal
import sys
from pathlib import Path
from typing import Any, List, Optional, Sequence, Tuple

from dyknow.errors import DyKnowError

NAMESPACE = "/dyknow_demo"
MANAGER = f"{NAMESPACE}/manager"

#: Real camera frames that may lie beside the checkout.
SHARED_FRAMES = Path(__file__).resolve().parents[3] / "shared" / "data" / "robocup_msl"

DONE, FAILED, INTERRUPTED = 0, 1, 130


def main(argv: Optional[Sequence[str]] = None) -> int:
    """Run the demonstration.

    Args:
        argv: arguments without the program's name; by default those of the process.

    Returns:
        0 if no frame was lost or doubled, 1 if one was or something failed, 130 after Ctrl-C.
    """
    options = _parse(sys.argv[1:] if argv is None else argv)
    # Asked to end, end as after Ctrl-C: with the processes that were started.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        return DONE if _run(options) else FAILED
    except KeyboardInterrupt:
        print("\ninterrupted", file=sys.stderr)
        return INTERRUPTED
    except DyKnowError as error:
        print(f"\ndemo: {error}", file=sys.stderr)
        return FAILED


def _parse(argv: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="dyknow.demo",
        description="Runs camera frames through a chain of nodelets, re-wires the chain while it "
        "runs, and counts the frames that were lost or doubled. Uses the ROS master that "
        "ROS_MASTER_URI names, or starts one for itself.",
        epilog="Exit code: 0 if no frame was lost, doubled or out of order, else 1; 130 after "
        "Ctrl-C.",
    )
    parser.add_argument(
        "--frames",
        type=_folder,
        metavar="DIR",
        help="folder of JPEG or PNG files; by default shared/data/robocup_msl beside the "
        "checkout, if it is there",
    )
    parser.add_argument("--rendered", action="store_true", help="render frames, use no files")
    parser.add_argument(
        "--seconds",
        type=_positive,
        default=6.0,
        help="time for each of the six wirings (%(default)g)",
    )
    parser.add_argument(
        "--rate", type=_positive, default=30.0, help="frames a second of each camera (%(default)g)"
    )
    # roslaunch and rostest append arguments of theirs, such as __name:=demo.
    return parser.parse_args([each for each in argv if ":=" not in each])


def _folder(text: str) -> Path:
    folder = Path(text)
    if not folder.is_dir():
        raise argparse.ArgumentTypeError(f"no folder '{text}'")
    return folder


def _positive(text: str) -> float:
    value = float(text)
    if not 0 < value < 1e6:
        raise argparse.ArgumentTypeError(f"expected a number above 0, not {text}")
    return value


def _run(options: Any) -> bool:
    # Imported here, so that --help and a wrong usage answer at once.
    from dyknow.demo.graph import CallFailed, Graph
    from dyknow.demo.processes import (
        Processes,
        master_answers,
        start_manager,
        start_roscore,
        system_master,
    )
    from dyknow.demo.story import Story
    from dyknow.demo.table import Table

    table = Table()
    sources, told = _frames(options)
    table.line(f"frames: {told}, {options.rate:g} Hz from each of two cameras")
    with Processes() as processes:
        if master_answers():
            table.line(f"ROS master: the one at {system_master()}")
        else:
            table.line(f"ROS master: our own, at {start_roscore(processes)}")
        graph = Graph(MANAGER)
        if graph.is_up():
            raise DyKnowError(
                f"{MANAGER} is registered at this master already: another demonstration runs "
                "there, or was killed ('rosnode cleanup' forgets it)"
            )
        if graph.uses_simulated_time():
            raise DyKnowError("/use_sim_time is set, but latencies need real time")
        pid = start_manager(processes, MANAGER, graph.is_up)
        table.line(f"nodelet manager: {MANAGER}, process {pid}")
        table.line()
        try:
            return Story(
                graph, table, processes.check, sources, options.rate, options.seconds
            ).run()
        except CallFailed:
            processes.check(patience=0.5)  # a process that ended is the better explanation
            raise
        finally:
            graph.forget()


def _frames(options: Any) -> Tuple[List[List[Path]], str]:
    """Deal the image files out to two cameras, and say where they come from."""
    from dyknow.demo.nodelets.camera import image_files

    folder = options.frames or (SHARED_FRAMES if SHARED_FRAMES.is_dir() else None)
    files = image_files(folder) if folder is not None and not options.rendered else []
    if options.frames and not options.rendered and not files:
        raise DyKnowError(f"no JPEG or PNG files in '{folder}'")
    if not files:
        return [[], []], "rendered, a ball on a field"
    one, two = files[0::2], files[1::2] or files
    return [[file.resolve() for file in each] for each in (one, two)], (
        f"{len(files)} real ones from {folder}"
    )
