"""`edge-vpr convert`: convert a recording to another format, or a map to a device's memory."""

from __future__ import annotations

import argparse
from pathlib import Path

from edge_vpr.errors import UsageError
from edge_vpr_tools.console import describe_faults, summary, watched
from edge_vpr_tools.flags import add_reading_arguments, open_from

EXAMPLES = """\
  edge-vpr convert drive.aedat4 drive.npz
  edge-vpr convert drive.csv drive.raw --sensor 346x260 --columns txyp
  edge-vpr convert map.npz map.h
  edge-vpr convert map.npz map.hex --address 0x08040000"""
#: files of a map for the memory of a microcontroller
IMAGES = (".h", ".bin", ".hex")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument("input", metavar="IN", help="recording of any known format, or a map")
    parser.add_argument(
        "output",
        metavar="OUT",
        help="file to write; its suffix names the format: .npz, .csv, .txt or .raw "
        "(EVT 2.0); a map becomes the image that the firmware reads from flash: .h (for C), .bin "
        "or .hex",
    )
    output = parser.add_argument_group("output")
    output.add_argument("--overwrite", action="store_true", help="replace the output if it exists")
    output.add_argument(
        "--address", metavar="A", help="with .hex, the address of the map in the device, such as "
        "0x08040000: a multiple of 16 (default: 0)",
    )  # fmt: skip
    add_reading_arguments(parser)


def run(args: argparse.Namespace) -> None:
    """Read the input and write the output, whole or not at all."""
    suffix = Path(args.output).suffix.lower()
    if args.address is not None and suffix != ".hex":
        raise UsageError(
            f"--address {args.address} is for an output .hex; others lie where you put them"
        )
    if suffix in IMAGES:
        _write_image(args, suffix)
        return
    from edge_vpr.archive import archive_kind
    from edge_vpr.files import check_output
    from edge_vpr.recordings import write_recording
    from edge_vpr.reference_map import KIND

    check_output(args.output, [args.input])
    if archive_kind(args.input) == KIND:
        raise UsageError(
            f"{args.input} is a map, which edge-vpr convert writes for a device's memory: end "
            f"{args.output} in {', '.join(IMAGES[:-1])} or {IMAGES[-1]}"
        )
    recording = open_from(args, args.input)
    n = write_recording(args.output, watched(recording, "converting"), overwrite=args.overwrite)
    summary(f"{args.output}: {n:,} events of {recording.sensor}{describe_faults(recording)}")


def _write_image(args: argparse.Namespace, suffix: str) -> None:
    """Write a map as the firmware reads it."""
    from edge_vpr.files import check_absent, check_output, replacing
    from edge_vpr.reference_map import ReferenceMap
    from edge_vpr_tools.estimate.of_map import design_of, memories_of
    from firmware_model.image import STRUCT_BYTES, image, ram_bytes
    from firmware_model.vectors.formats import image_header, intel_hex

    check_output(args.output, [args.input])
    check_absent(args.output, args.overwrite)
    reference = ReferenceMap.load(args.input)
    design = design_of(reference)
    flash, ram = image(memories_of(reference, design)), ram_bytes(design)
    address = _address(args.address or "0", len(flash))
    data = flash
    if suffix != ".bin":
        text = intel_hex(flash, address) if suffix == ".hex" else image_header(flash, ram)
        data = text.encode("ascii")
    with replacing(args.output, args.overwrite) as path:
        path.write_bytes(data)
    where = f" at {address:#010x}" if suffix == ".hex" else ""
    summary(
        f"{args.output}: {design.places:,} places, {len(flash):,} bytes of flash{where}; "
        f"{ram + STRUCT_BYTES:,} bytes of RAM: {ram:,} for vpr_reset, {STRUCT_BYTES} for "
        "vpr_design_t and vpr_state_t, beside the stack"
    )


def _address(text: str, size: int) -> int:
    """Read an address in C's notation, from which on so many bytes fit 32 bits."""
    try:
        address = int(text, 0)
    except ValueError:
        address = -1
    if not 0 <= address < 1 << 32 or address % 16:
        raise UsageError(
            f"--address {text}: expected a multiple of 16 of at most 32 bits, such as 0x08040000"
        )
    if address + size > 1 << 32:
        raise UsageError(
            f"--address {text}: the map's {size:,} bytes would end beyond 32 bits: give a lower one"
        )
    return address
