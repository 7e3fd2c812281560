"""The channels of a data set: one for every signal that was measured."""

import numpy as np

from ocp.diagnose.dataset import TRACKER, DataSet
from ocp.diagnose.engine.channel_system import Channel
from ocp.diagnose.tracker.baseline import believed_baseline
from ocp.diagnose.tracker.channel import TrackerChannel
from ocp.shell.progress import Phases
from robots.calibration.mistakes import refuse_mistakes
from robots.calibration.solver import Campaign
from robots.errors import BadInput


def channels_of(data: DataSet, phases: Phases) -> list[Channel]:
    """Channels in the order tracker, force, joint, the believed cell fitted to each. Raises BadInput of every part."""
    found: list[Channel] = []
    if data.readings is not None:
        with phases.phase("tracker"):
            found.append(tracker_channel(data))
    if data.log is not None:
        with phases.phase("force"):
            found.append(_force_channel(data))
    if data.joints is not None:
        with phases.phase("joints"):
            found.append(_joint_channel(data))
    return found


def tracker_channel(data: DataSet) -> TrackerChannel:
    """The believed arm refitted to the readings. Raises BadInput: readings that are a mistake, or that place nothing."""
    setup, readings = data.setup, data.readings
    assert readings is not None
    campaign = Campaign(setup.robot, readings, setup.payloads, setup.instrument)
    try:
        refuse_mistakes(campaign)
        task, fit = believed_baseline(campaign, setup.compliant_joints, setup.tables.reference_temperature_C, _stated(data))
    except np.linalg.LinAlgError:
        raise BadInput(
            f"{readings.path}: the readings leave something open that no prior holds, as the tracker's turn; measure more "
            "postures, with all axes moved, and give the nests' places in [tracker.targets]"
        ) from None
    return TrackerChannel(task, fit)


def _force_channel(data: DataSet) -> Channel:
    """The believed contact refitted to the log, the arm as the tracker's readings place it."""
    from ocp.diagnose.force.channel import force_channel  # blade and contact: only for those who measured force

    assert data.cell is not None and data.log is not None
    return force_channel(data.cell, data.log, None if data.readings is None else data.folder / TRACKER)


def _joint_channel(data: DataSet) -> Channel:
    """Link-side encoders."""
    from ocp.diagnose.joints.channel import joint_channel

    assert data.joints is not None
    return joint_channel(data.joints, data.setup.robot, data.payload, _stated(data))


def _stated(data: DataSet) -> bool:
    """Whether the cell states its springs itself: those are believed more than a catalogue's."""
    return data.setup.tables.robot.stiffness_Nm_per_rad is not None
