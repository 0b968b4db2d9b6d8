"""Gateway: implementation of the role `robot` for a Kawasaki controller."""

from common.runtime.service import main
from services.gateway.service import Gateway

if __name__ == "__main__":
    main("robot", Gateway, implementation="gateway")
