"""The commands (verbs) of the command line, by group, each with its one line of help."""

from __future__ import annotations

#: The arguments of `edge-vpr VERB` are in `arguments.VERB_arguments`, which imports nothing heavy.
#: Its function `run(args)` is in `commands.VERB`, which is imported only when the verb runs. In the
#: names of these modules, the space in a verb of two words is an underscore.
GROUPS: dict[str, dict[str, str]] = {
    "first steps": {
        "demo": "simulate two drives of a street, map one, match the other, write a report",
        "simulate": "write simulated recordings of two drives of one route, with ground truth",
    },
    "recognise places": {
        "map": "make a reference map from a recording of one drive",
        "match": "find the place of the map for each window of another drive",
        "evaluate": "compare matches with the ground truth: precision, recall, figures",
        "sweep": "run many settings on many drives, on this machine or on a cluster",
        "compare": "show the results of several runs and sweeps in one table and one figure",
        "calibrate": "learn how probable right matches are, from a drive with ground truth",
    },
    "recordings": {
        "info": "show what a recording holds: sensor, events, duration, rate, polarity, faults",
        "convert": "convert a recording to another format",
    },
    "live cameras": {
        "stream": "localise live from a camera on a serial line, TCP, UDP, a pipe or a file",
        "bridge": "replay a recording over a serial line or a network, like a camera",
        "ports": "list the serial ports and the protocol that each device probably uses",
    },
    "hardware": {
        "estimate": "estimate operations, memory, time and modelled energy of a design",
        "golden": "write test vectors for firmware and FPGA: inputs with exact expected outputs",
        "golden verify": "check test vectors, and the results of a device against them",
        "hardware": "write the hardware core of a design as a project for an FPGA board",
        "profile": "measure speed, latency, memory and, with a power sensor, energy per match",
        "profile compare": "compare two profiles",
        "profile trace": "add the energy that an external power meter recorded to a profile",
    },
    "this program": {
        "doctor": "check this machine: libraries, kernels, ports, sensors; show what is missing",
        "experiment": "repeat an experiment whose figures the documentation quotes",
        "completion": "print a script by which a shell completes commands and flags",
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

    Flags may stand anywhere. ``golden verify`` is taken as the verb of two words, not as ``golden``
    with an argument.

    Returns
    -------
    verb : str
        Empty if all words are flags. Whether such a verb exists is not checked.
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


#: flags that every verb has; they may stand before the verb
GENERAL_FLAGS = ("-h", "--help", "-q", "--quiet", "-v", "--verbose", "--debug")
