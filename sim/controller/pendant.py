"""What a person does at the controller: motor power, REPEAT and TEACH, teach lock, HOLD and RUN."""

from sim.controller.program_control import Control


class Pendant:
    """Buttons and switches. Each does what the real one does, at once."""

    def __init__(self, controller: Control) -> None:
        """Stand in front of a controller."""
        self._controller = controller

    def motor_power(self, *, on: bool) -> None:
        """Switch the motors; off holds the program. Not while the emergency stop is pressed."""
        if not on:
            self._controller.hold()
        if not (on and self._controller.emergency):
            self._controller.robot.power(on=on)

    def repeat(self) -> None:
        """Turn the switch to REPEAT; what was held stays held."""
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
        """Press the emergency stop: the arm brakes, the motors go off, the program is held."""
        self._controller.emergency = True
        self.motor_power(on=False)

    def release_emergency_stop(self) -> None:
        """Pull the button out again; nothing moves by that."""
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
