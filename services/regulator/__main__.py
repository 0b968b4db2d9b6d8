"""Force regulator: wrench and robot state in, proposed flange pose out."""

from common.runtime.service import main
from services.regulator.service import Regulator

if __name__ == "__main__":
    main("regulator", Regulator)
