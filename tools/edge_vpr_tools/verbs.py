"""The verbs of the command line by group, each with the one line that helps."""

from __future__ import annotations

#: `edge-vpr VERB` has its arguments in `arguments.VERB_arguments`, which imports nothing heavy, and
#: `run(args)` in `commands.VERB`, which is imported only when it runs. A space in a verb of two
#: words is an underscore there.
GROUPS: dict[str, dict[str, str]] = {
    "first steps": {
        "demo": "simulate two drives of a street, map one, match the other, and report",
        "simulate": "simulate two drives of one route as recordings, with ground truth",
    },
    "recognise places": {
        "map": "make a reference map of one drive",
        "match": "match a query drive against a map",
        "evaluate": "compare matches with a ground truth",
        "sweep": "compute variants x drives x seeds, on this machine or on a cluster",
        "compare": "put runs and sweeps into one table and one figure",
        "calibrate": "learn the probability of a right match from an evaluated drive",
    },
    "recordings": {
        "info": "say what a recording holds: sensor, events, duration, rate, polarity, faults",
        "convert": "convert a recording to another format",
    },
    "live cameras": {
        "stream": "localise live from a camera on a serial line, TCP, UDP, a pipe or a file",
        "bridge": "replay a recording over a line, as a camera would send it",
        "ports": "list serial ports, with a guess which protocol fits",
    },
    "hardware": {
        "estimate": "estimate operations, memory, time and modelled energy of a design",
        "golden": "write golden vectors for firmware and FPGA designs",
        "golden verify": "check golden vectors, and a device's results against them",
        "hardware": "write the hardware core of a design as a project for an FPGA board",
        "profile": "measure speed, latency, memory and, with a power sensor, joules a match",
        "profile compare": "compare two profiles",
        "profile trace": "add the joules of an external meter's trace to a profile",
    },
    "this program": {
        "doctor": "check this machine: libraries, kernels, ports, sensors, and what is missing",
        "experiment": "repeat the experiments whose figures the documentation quotes",
        "completion": "print the completion script of a shell",
    },
}
VERBS = {verb: text for verbs in GROUPS.values() for verb, text in verbs.items()}

EXAMPLES = """\
  edge-vpr demo
  edge-vpr map monday.raw -o monday.npz
  edge-vpr match monday.npz tuesday.raw -o results/tuesday
  edge-vpr evaluate results/tuesday --ground-truth monday.nmea tuesday.nmea --tolerance 70"""


def module_name(verb: str) -> str:
    """Return the name of a verb's module in `commands`."""
    return verb.replace(" ", "_")


def find_verb(words: list[str]) -> tuple[str, list[str]]:
    """Split a command line into its verb and the other words.

    Flags may stand anywhere; the longest verb wins, so that ``golden verify`` is not ``golden``.

    Parameters
    ----------
    words : list of str

    Returns
    -------
    verb : str
        Empty if there is no word that is not a flag. It need not exist.
    rest : list of str
        All other words, in order.
    """
    places = [i for i, word in enumerate(words) if not word.startswith("-")]
    if not places:
        return "", words
    first = places[0]
    rest = words[:first] + words[first + 1 :]
    if len(places) > 1:
        second = places[1]
        pair = f"{words[first]} {words[second]}"
        between = words[first + 1 : second]
        if pair in VERBS and all(word in GENERAL_FLAGS for word in between):
            del rest[second - 1]
            return pair, rest
    return words[first], rest


#: flags of every verb, which may stand before it too
GENERAL_FLAGS = ("-h", "--help", "-q", "--quiet", "-v", "--verbose", "--debug")
