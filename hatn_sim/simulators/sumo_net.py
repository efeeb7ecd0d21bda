"""A SUMO net without traffic -> its lanes, read by SUMO itself in a process of its own."""

from __future__ import annotations

from pathlib import Path

from hatn_sim.datatypes import Lane
from hatn_sim.errors import InputError
from hatn_sim.safe_xml import check_xml
from hatn_sim.simulators.sumo_lanes import lanes_of
from hatn_sim.simulators.sumo_messages import Refused, Started
from hatn_sim.simulators.sumo_process import SumoWorker, WorkerDiedError, Workers


def read_net(path: Path) -> list[Lane]:
    """The lanes of a net (.net.xml, also gzipped), those for pedestrians only excepted.

    They are those of a `SumoSimulator` on this net. Raises InputError where it is no net, or SUMO
    refuses it. SUMO dies of XML that is cut off, and expands whatever it is given: hence the check
    before.
    """
    check_xml(path, "net")
    workers = Workers()
    worker = None
    try:
        worker = SumoWorker(workers)
        answer = worker.ask(("--net-file", str(path), "--no-step-log", "true"))
        if isinstance(answer, Refused):
            reason = worker.complaint() or " ".join(answer.reason.split())
            raise InputError(f"{path}: SUMO refuses this net: {reason}")
    except WorkerDiedError as error:
        raise InputError(f"{path}: SUMO cannot read this net: {error}") from None
    finally:
        if worker is not None:
            worker.close()
        workers.close()
    assert isinstance(answer, Started)
    return lanes_of(answer.lane_table)
