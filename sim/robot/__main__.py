"""Simulated robot: implements the roles robot and sensor of a cell."""

from common.runtime.service import main
from sim.robot.service import SimRobot

if __name__ == "__main__":
    main(("robot", "sensor"), SimRobot, implementation="sim")
