"""Teach pendant and operation panel: motor power, REPEAT/TEACH, teach lock, HOLD/RUN."""

from sim.controller.program_control import ProgramControl


class Pendant:
    """Buttons and switches of the controller, with immediate effect."""

    def __init__(self, controller: ProgramControl) -> None:
        """Connect to a controller."""
        self._controller = controller

    def motor_power(self, *, on: bool) -> None:
        """Switch the motors; off holds the program. Inhibited by a pressed emergency stop."""
        if not on:
            self._controller.hold()
        if not (on and self._controller.emergency):
            self._controller.robot.power(on=on)

    def repeat(self) -> None:
        """Turn the switch to REPEAT; a held program stays held."""
        self._controller.repeat_mode = True

    def teach(self) -> None:
        """Turn the switch to TEACH: the robot program is held."""
        self._controller.hold()
        self._controller.repeat_mode = False

    def teach_lock(self, *, on: bool) -> None:
        """Turn the teach lock; on in REPEAT mode holds the robot program."""
        if on:
            self._controller.hold()
        self._controller.teach_lock = on

    def hold(self) -> None:
        """Turn HOLD/RUN to HOLD."""
        self._controller.hold()

    def run(self) -> None:
        """Turn HOLD/RUN to RUN and press cycle start. Raises AsError P1000 to P1013."""
        self._controller.resume()

    def emergency_stop(self) -> None:
        """Press the emergency stop: brake the arm, switch the motors off, hold the program."""
        self._controller.emergency = True
        self.motor_power(on=False)

    def release_emergency_stop(self) -> None:
        """Release the emergency stop; this starts no motion."""
        self._controller.emergency = False

    def error_reset(self) -> None:
        """ERESET."""
        self._controller.reset_error()

    def execute(self, name: str, *, cycles: int = 1) -> None:
        """Select a program and start it. Raises AsError P1000 to P1014."""
        self._controller.held = self._controller.robot.queue.held = False
        self._controller.execute(name, cycles=cycles)

    def abort(self) -> None:
        """ABORT."""
        self._controller.abort()

    def monitor_speed(self, percent: float) -> None:
        """Set the monitor speed [%]."""
        self._controller.set_monitor_speed(percent)
