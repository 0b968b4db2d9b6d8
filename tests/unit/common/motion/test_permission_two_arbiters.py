"""The robot's response to two processes that publish as arbiter."""

from common.motion.permission import CommandGate
from forcemesh.clock import NS_PER_S
from forcemesh.codec import Header
from forcemesh.messages import Permission, RobotCommand
from forcemesh.reader import Reading


def test_the_robot_holds_while_two_processes_write_its_commands() -> None:
    """A command that comes while another writer of the same topic is alive moves nothing."""
    command = RobotCommand(kind="idle", permission=Permission(host="pc", lease=1, deadline_s=1.0))
    header = Header(seq=1, epoch=2, boot="b", stamp_ns=1)
    verdict = CommandGate(1).judge(Reading(command, header, 0.0, "", conflict=True), NS_PER_S)
    assert verdict.command is None
    assert verdict.hold_code == "two_writers"
