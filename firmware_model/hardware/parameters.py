"""Parameters of the core, from a design: every size and width as the model has it."""

from __future__ import annotations

from firmware_model.design import Design
from firmware_model.errors import DesignError

#: name of the generated package, and of its file
PACKAGE = "vpr_design"
#: tables that the core reads from files; places are loaded
TABLES = ("displacement", "lookup", "codes", "code_tables")


def parameters(design: Design) -> dict[str, tuple[str, int]]:
    """List the parameters of ``vpr_core``.

    Parameters
    ----------
    design : Design

    Returns
    -------
    dict of str to (str, int)
        SystemVerilog type and value by name, in the order of the core's declaration.

    Raises
    ------
    DesignError
        If the design has a part that the core does not have.
    """
    if design.filters or design.own_mean:
        raise DesignError(
            "the core in SystemVerilog has sequences and fixed code tables so far: take a design "
            'with matching = "sequence" and without own-mean codes'
        )
    bits = {name: form.width for name, form in design.formats.items()}
    return {
        "HEIGHT": ("int", design.height),
        "PIXELS": ("int", design.pixels),
        "POLARITY": ("bit", int(design.polarity)),
        "LOOKUP_DEPTH": ("int", design.lookup_depth),
        "SLOTS": ("int", design.slots),
        "TABLES": ("int", len(design.full_scales)),
        "COUNT_MAX": ("int", design.count_max),
        "BY_TIME": ("bit", int(design.window == "time")),
        "TAU_US": ("logic [63:0]", design.tau_us),
        "WINDOW_EVENTS": ("logic [31:0]", design.window_events),
        "PLACES": ("int", design.places),
        "WORDS": ("int", design.words),
        "LANES": ("int", design.lanes),
        "LENGTH": ("int", design.length),
        "EXCLUSION": ("int", design.exclusion),
        "BY_MARGIN": ("bit", int(design.accept == "margin")),
        "MARGIN": ("logic [31:0]", design.margin),
        "NUMERATOR": ("logic [15:0]", design.ratio[0]),
        "DENOMINATOR": ("logic [15:0]", design.ratio[1]),
        "EVENT_TIME_BITS": ("int", 32 if design.timestamp_bits <= 32 else 64),
        "TIMESTAMP_BITS": ("int", bits["timestamp"]),
        "COLUMN_BITS": ("int", bits["column"]),
        "ROW_BITS": ("int", bits["row"]),
        "ADDRESS_BITS": ("int", bits["address"]),
        "OWNER_BITS": ("int", bits["owner"]),
        "SLOT_BITS": ("int", bits["slot"]),
        "COUNT_BITS": ("int", bits["count"]),
        "WINDOW_COUNT_BITS": ("int", bits["window_count"]),
        "TABLE_BITS": ("int", bits["table"]),
        "CODE_BITS": ("int", bits["code"]),
        "DISTANCE_BITS": ("int", bits["distance"]),
        "SEQUENCE_BITS": ("int", bits["sequence"]),
        "PRODUCT_BITS": ("int", bits["product"]),
        "PLACE_BITS": ("int", bits["place"]),
    }


def package(design: Design) -> str:
    """Write the parameters as a SystemVerilog package.

    Parameters
    ----------
    design : Design

    Returns
    -------
    str
        Source of `PACKAGE`, which ``vpr_device.sv`` gives to the core.
    """
    lines = [
        "// Parameters of one design, made by edge-vpr from its design.toml: do not edit.",
        f"package {PACKAGE};",
    ]
    for name, (kind, value) in parameters(design).items():
        lines.append(f"    localparam {kind} {name} = {_literal(kind, value)};")
    return "\n".join([*lines, "endpackage", ""])


def _literal(kind: str, value: int) -> str:
    widths = {"bit": 1, "logic [15:0]": 16, "logic [31:0]": 32, "logic [63:0]": 64}
    return f"{widths[kind]}'d{value}" if kind in widths else str(value)
