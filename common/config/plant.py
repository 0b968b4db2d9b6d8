"""Plant of a cell: what its file states about arm, link, filter and contact, derived once. Pure."""

from dataclasses import dataclass

PROBE_N = 5.0  # overshoot of the first touch, which verifies the signs and must stay gentle


@dataclass(frozen=True, slots=True)
class Delays:
    """Elements in series: dead time, lag of the servo, low-pass of the wrench."""

    delay_s: float
    lag_s: float
    filter_s: float


@dataclass(frozen=True, slots=True)
class Plant:
    """Arm, link, wrench filter and stiffest contact of a cell: the basis of laws and gains."""

    robot_delay_s: float  # from a set point at the controller to the first motion of the arm
    lag_s: float  # of the arm's servo
    chain_s: float  # latency of the processes, from sensor sample to robot
    median_s: float
    lowpass_s: float
    control_hz: float
    robot_hz: float
    sensor_hz: float
    stiffness_N_m: float
    tilt_stiffness_Nm_rad: float
    inertia_kg: float  # in front of the sensor
    inertia_kg_m2: float  # the same about the TCP
    bandwidth_rad_s: float  # of the arm
    rounding_m: float  # largest distance between a set point and the one in the gateway's packet
    approach_budget_N: float
    approach_asked_m_s: float  # of the cell file

    @property
    def servo_s(self) -> float:
        """Delay and lag of the robot together [s]."""
        return self.robot_delay_s + self.lag_s

    @property
    def arm(self) -> Delays:
        """From a released command to the reported pose."""
        return Delays(self.robot_delay_s + self.chain_s, self.lag_s, 0.0)

    @property
    def wrench(self) -> Delays:
        """From the measured pose to the filtered force."""
        return Delays(self.median_s, 0.0, self.lowpass_s)

    @property
    def loop(self) -> Delays:
        """From a command to the filtered force; with half a period their sum is tau."""
        return Delays(self.arm.delay_s + self.median_s, self.lag_s, self.lowpass_s)

    @property
    def filter_delay_s(self) -> float:
        """Delay of the wrench filter [s]."""
        return self.lowpass_s + self.median_s

    @property
    def tau_s(self) -> float:
        """Delay from a change of force to the arm's response [s]."""
        return self.servo_s + self.filter_delay_s + 0.5 / self.control_hz + self.chain_s

    @property
    def loop_hz(self) -> float:
        """Loop rate: the slower one of regulator and robot [Hz]."""
        return min(self.control_hz, self.robot_hz)

    @property
    def approach_limit_m_s(self) -> float:
        """Fastest approach whose first contact stays within the force budget [m/s].

        Until the arm responds, the force grows by stiffness times speed times tau.
        """
        return self.approach_budget_N / (self.stiffness_N_m * self.tau_s)

    @property
    def approach_m_s(self) -> float:
        """Approach speed within its limit [m/s]."""
        return min(self.approach_asked_m_s, self.approach_limit_m_s)

    @property
    def probe_m_s(self) -> float:
        """Approach speed of a law, whose first touch adds at most PROBE_N as well [m/s]."""
        return min(self.approach_m_s, PROBE_N / (self.stiffness_N_m * self.tau_s))

    def memory_s(self, taus: float, periods: float, least_s: float) -> float:
        """Return a time constant of forgetting: so many tau, loop periods, or at least this."""
        return max(taus * self.tau_s, periods / self.loop_hz, least_s)
