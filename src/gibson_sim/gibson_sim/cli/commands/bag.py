"""``gibson-sim bag``: checks, plays, plots and repairs bags, writes images and videos from bags, and bags from images."""

from __future__ import annotations

import argparse
from dataclasses import fields
from pathlib import Path
from typing import Any

from gibson_sim import __version__
from gibson_sim.bags import folders
from gibson_sim.bags.check import check_bag
from gibson_sim.bags.film import write_film, write_film_strip
from gibson_sim.bags.images.from_files import FOLDER_RATE_HZ, SUFFIXES as IMAGE_SUFFIXES, CameraSettings, write_bag
from gibson_sim.bags.playback.options import DEFAULT_CLOCK_HZ, PlayOptions
from gibson_sim.bags.progress import progress_bar
from gibson_sim.bags.video import write_contact_sheet, write_pictures
from gibson_sim.bags.writer import repair
from gibson_sim.cli.environment import add_network, environment_of, require_nodes
from gibson_sim.cli.options import given
from gibson_sim.cli.processes import become
from gibson_sim.errors import RecordError
from gibson_sim.picture_files import SUFFIXES


def add_parser(subparsers: Any) -> None:
    """Adds the sub-command with its own sub-commands."""
    parser = subparsers.add_parser(
        "bag", help="check, play, plot or repair a bag; write videos and film strips of it; convert images to a bag"
    )
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    check = actions.add_parser(
        "check", help="print counts, rates, stamps, contacts and odometry of a bag; exit code 1 if stamps disagree"
    )
    check.set_defaults(run=_check)
    playing = actions.add_parser(
        "play",
        help="publish the messages of a bag at their recorded times, with options of `ros2 bag play`, for machines without it",
    )
    playing.set_defaults(run=_play)
    plot = actions.add_parser("plot", help="draw path, velocities, contacts and rates of a bag; needs matplotlib")
    plot.set_defaults(run=_plot)
    repairing = actions.add_parser(
        "repair",
        help="check every byte of a bag and make it readable after a crash, a full disk or bit errors; keeps damaged files under another name; exit "
        "code 1 if messages are lost",
    )
    repairing.set_defaults(run=_repair)
    video = actions.add_parser("video", help="write a video and a contact sheet of RGB and depth")
    video.set_defaults(run=_video)
    sheet = actions.add_parser("sheet", help="write only a contact sheet")
    sheet.set_defaults(run=_sheet)
    film = actions.add_parser("film", help="write a film strip or a video of several cameras, stacked")
    film.set_defaults(run=_film)
    making = actions.add_parser("from-images", help="convert a folder of photographs, or a video, to a bag")
    making.set_defaults(run=_from_images)
    _add_from_images(making)
    for action in (check, playing, plot, repairing, video, sheet, film):
        action.add_argument("bag", type=Path, metavar="DIR", help="folder of the bag")
    _add_play(playing)
    plot.add_argument(
        "files", type=Path, nargs="*", metavar="FILE", help="picture (.png) or page (.html); one or more (default: DIR_plot.png)"
    )
    plot.add_argument("--robot", default="", metavar="NAME", help="show only the robot with this namespace (default: all)")
    video.add_argument("file", type=Path, metavar="FILE.mp4")
    sheet.add_argument("file", type=Path, metavar="FILE.png")
    sheet.add_argument("--columns", type=int, default=4, help="images per row (default: 4)")
    sheet.add_argument("--rows", type=int, default=4, help="rows of images (default: 4)")
    film.add_argument("files", type=Path, nargs="+", metavar="FILE", help="film strip (.png, .jpg) or video (.mp4); one or more")
    film.add_argument(
        "--topics", default="", help="image topics or cameras, separated by commas, from the top (default: all colour images)"
    )
    film.add_argument("--columns", type=int, default=6, help="moments in the strip (default: 6)")
    film.add_argument("--width", type=int, metavar="PX", help="width of an image (default: 320 in a strip, 640 in a video)")
    film.add_argument(
        "--from", dest="begin", type=float, default=0.0, metavar="S", help="begin S seconds after the start of the bag"
    )
    film.add_argument("--to", dest="end", type=float, default=0.0, metavar="S", help="end S seconds after the start of the bag")
    film.add_argument("--fps", type=float, help="frames per second of the video (default: by the stamps)")
    film.add_argument(
        "--speed", type=float, default=1.0, help="playback speed: seconds of the run per second of video (default: 1)"
    )


def _add_play(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "-r", "--rate", type=float, metavar="FACTOR", help="seconds of the bag per second of wall time (default: 1)"
    )
    parser.add_argument("--topics", nargs="+", metavar="TOPIC", help="topics to play, separated by spaces (default: all)")
    parser.add_argument("--exclude-topics", nargs="+", metavar="TOPIC", help="topics not to play, separated by spaces")
    parser.add_argument(
        "-m", "--remap", nargs="+", metavar="OLD:=NEW", help="publish the topic OLD of the bag as NEW; one or more rules"
    )
    parser.add_argument("-l", "--loop", action="store_true", help="start again at the end, until Ctrl-C")
    parser.add_argument("--start-offset", type=float, metavar="S", help="start S seconds after the start of the bag")
    parser.add_argument(
        "--playback-duration", type=float, metavar="S", help="end after S seconds of the bag (default: at its end)"
    )
    parser.add_argument(
        "--clock",
        type=float,
        nargs="?",
        const=DEFAULT_CLOCK_HZ,
        metavar="HZ",
        help=f"publish the time of the playback on /clock, HZ times per second of wall time (without a number: {DEFAULT_CLOCK_HZ:g}); "
        "the bag's own /clock is never played",
    )
    parser.add_argument(
        "-d", "--delay", type=float, metavar="S", help="wait S seconds before the start, and before each repetition"
    )
    parser.add_argument(
        "--wait-for",
        nargs="+",
        metavar="TOPIC[:N]",
        help="wait until N nodes (1) subscribe to each of these published topics; without it, playback starts when the nodes that already "
        "run are connected",
    )
    parser.add_argument("-p", "--start-paused", action="store_true", help="start paused; SPACE resumes, and pauses at any time")
    add_network(parser)


def _play(args: argparse.Namespace) -> int:
    """Replaces this process by the play node, so that it owns the terminal, the signals and the exit code."""
    require_nodes()
    names = [field.name for field in fields(PlayOptions) if field.name != "bag"]
    values: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value for name, value in given(args, names).items()
    }
    options = PlayOptions(str(args.bag), **values)
    folders.check_bag(args.bag)
    become("play_node", [options.to_json()], environment_of(args))


def _add_from_images(parser: argparse.ArgumentParser) -> None:
    default = CameraSettings()
    parser.add_argument(
        "source",
        type=Path,
        metavar="FOLDER|VIDEO",
        help=f"folder of images ({', '.join(IMAGE_SUFFIXES)}) in the order of their names, or a video",
    )
    parser.add_argument("--output", type=Path, required=True, metavar="BAG", help="folder of the new bag")
    parser.add_argument(
        "--topic",
        default=default.topic,
        help=f"topic of the images; camera_info is published beside it (default: {default.topic})",
    )
    parser.add_argument(
        "--rate",
        type=float,
        metavar="HZ",
        help=f"images per second: for a folder, the rate at which they were taken (default: {FOLDER_RATE_HZ:g}); "
        "for a video, the highest rate (default: all frames)",
    )
    parser.add_argument("--frame", default=default.frame, help=f"frame of the images (default: {default.frame})")
    parser.add_argument(
        "--hfov",
        type=float,
        metavar="DEG",
        help="horizontal field of view of a pinhole camera, degrees (default: camera_info is marked as uncalibrated)",
    )
    parser.add_argument("--compressed", action="store_true", help="store JPEG images, on TOPIC/compressed")


def _from_images(args: argparse.Namespace) -> int:
    settings = CameraSettings(args.topic, args.rate, args.frame, args.hfov, args.compressed)
    with progress_bar("images") as advance:
        written = write_bag(args.source, args.output, settings, advance)
    print(written.text())
    return 0


def _check(args: argparse.Namespace) -> int:
    report = check_bag(args.bag)
    print(report.text())
    return 0 if report.ok else 1


def _plot(args: argparse.Namespace) -> int:
    from gibson_sim.bags.plots.plot import write_plots  # loaded here: the others draw nothing

    folder = args.bag.resolve()
    files = args.files or [args.bag.parent / f"{folder.name}_plot.png"]  # DIR.png is the contact sheet of a video
    for path in write_plots(args.bag, files, args.robot, f"made by gibson-sim {__version__} bag plot"):
        print(path)
    return 0


def _repair(args: argparse.Namespace) -> int:
    result = repair(args.bag)
    print(result.text())
    return 0 if result.complete else 1


def _video(args: argparse.Namespace) -> int:
    for path in write_pictures(args.bag, args.file):
        print(path)
    return 0


def _sheet(args: argparse.Namespace) -> int:
    print(write_contact_sheet(args.bag, args.file, args.columns, args.rows))
    return 0


def _film(args: argparse.Namespace) -> int:
    topics = [topic.strip() for topic in args.topics.split(",") if topic.strip()]
    known = (*SUFFIXES, ".mp4")
    for path in args.files:
        if path.suffix.lower() not in known:
            raise RecordError(f"film {path}: the name must end in {', '.join(known)}")
    for path in args.files:
        path.parent.mkdir(parents=True, exist_ok=True)
        given: dict[str, Any] = {"topics": topics, "begin": args.begin, "end": args.end}
        if args.width is not None:
            given["width"] = args.width
        if path.suffix.lower() in SUFFIXES:
            print(write_film_strip(args.bag, path, columns=args.columns, **given))
        else:
            print(write_film(args.bag, path, fps=args.fps, speed=args.speed, **given))
    return 0
