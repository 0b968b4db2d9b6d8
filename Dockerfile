# The images of a cell, one for each kind of process: `control` without simulation and page, `sim`,
# and `panel`, which has the command line and therefore everything. docker-compose.yml gives each
# container its kind and its command.

FROM python:3.11-slim-bookworm AS build
ARG KIND=panel
ENV PIP_NO_CACHE_DIR=1 PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_ROOT_USER_ACTION=ignore
RUN python3 -m venv /venv
WORKDIR /app
COPY requirements-$KIND.lock ./
# Wheels only, each with its hash. Of pin's files stays what an import loads: not headers, libraries for
# other programs, or copies under two more names (a wheel holds no links).
RUN /venv/bin/pip install -q --require-hashes --only-binary :all: \
        -r requirements-$KIND.lock \
    && cd /venv/lib/python3.11/site-packages/cmeel.prefix && rm -rf include bin share \
    && /venv/bin/python -c 'import eigenpy, pinocchio, pathlib; used = open("/proc/self/maps").read().split(); \
        [file.unlink() for file in pathlib.Path("lib").glob("lib*") if str(file.resolve()) not in used]' \
    && find /venv -type d -name tests -path '*/numpy/*' -prune -exec rm -rf {} +
COPY pyproject.toml LICENSE ./
COPY arms arms
COPY cells cells
COPY cli cli
COPY common common
COPY control control
COPY controller controller
COPY forcemesh forcemesh
COPY identification identification
COPY launch launch
COPY services services
COPY sim sim
COPY tuning tuning
# The file system is read-only at run time, so byte code is written now. Nothing is installed later.
RUN /venv/bin/pip install -q --no-deps --no-build-isolation -e . \
    && /venv/bin/python -m compileall -q cli common control controller forcemesh identification launch services sim tuning \
    && /venv/bin/pip uninstall -q -y setuptools pip

FROM python:3.11-slim-bookworm
# pin's libraries want OpenMP, which the slim base does not have.
RUN ldconfig -p | grep -q libgomp.so.1 \
    || (apt-get update && apt-get install -y --no-install-recommends libgomp1 \
        && rm -rf /var/lib/apt/lists/*)
ARG VERSION=0.1.0
ARG REVISION=unknown
LABEL org.opencontainers.image.title="forcemesh" \
      org.opencontainers.image.description="Open force control for Kawasaki arms: processes of a cell" \
      org.opencontainers.image.licenses="Apache-2.0" \
      org.opencontainers.image.version=$VERSION \
      org.opencontainers.image.revision=$REVISION
ENV PATH=/venv/bin:$PATH \
    PYTHONUNBUFFERED=1 \
    PYTHONDONTWRITEBYTECODE=1 \
    HOME=/tmp \
    MPLCONFIGDIR=/tmp/matplotlib
# A volume that compose makes takes over whose they are.
RUN mkdir /calibration /recordings && chown 10001:10001 /calibration /recordings
COPY --from=build /venv /venv
COPY --from=build /app /app
WORKDIR /app
USER 10001:10001
