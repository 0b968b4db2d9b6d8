"""The facts of a cell file that its hub gives to clients."""

from common.config.cell import CellConfig
from common.config.load import cell_hash
from forcemesh.cell_info import CellInfo
from forcemesh.client import rotations as turning
from forcemesh.messages import PoseRecord
from forcemesh.topics import TOPICS


def cell_info(cell: CellConfig) -> CellInfo:
    """Return what a client may ask the hub of this cell for."""
    tool = cell.tool.T_flange_tcp
    return CellInfo(
        cell=cell.cell,
        config_hash=cell_hash(cell),
        roles=cell.roles.model_dump(),
        rates_hz={topic.key: cell.rate_hz(topic) for topic in TOPICS},
        deadlines_s={topic.key: cell.stale_after_s(topic) for topic in TOPICS},
        T_flange_tcp=PoseRecord(
            position_m=tool.position_m, orientation_xyzw=turning.from_oat_deg(tool.oat_deg)
        ),
        touch_N=cell.force.touch_N,
    )
