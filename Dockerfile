# syntax=docker/dockerfile:1
# One image for every part: server, shaper, client and encoder differ by their command alone.
FROM python:3.11-slim AS build
RUN apt-get update && apt-get install -y --no-install-recommends g++ && rm -rf /var/lib/apt/lists/*
ENV PIP_NO_CACHE_DIR=1 PIP_DISABLE_PIP_VERSION_CHECK=1
WORKDIR /src
COPY constraints.txt pyproject.toml README.md LICENSE NOTICE ./
COPY kernels kernels
COPY common common
COPY protocol protocol
COPY gpu gpu
COPY encoder encoder
COPY server server
COPY client client
COPY shaper shaper
COPY research research
COPY bench bench
COPY web web
RUN python -m venv /opt/cags && /opt/cags/bin/pip install -c constraints.txt ./kernels '.[scale]'

FROM python:3.11-slim
COPY --from=build /opt/cags /opt/cags
# caches go where a read-only root can be written
ENV PATH=/opt/cags/bin:$PATH PYTHONUNBUFFERED=1 XDG_CACHE_HOME=/tmp/cache XDG_CONFIG_HOME=/tmp/config
RUN useradd --create-home --uid 10001 cags && mkdir /data && chown cags /data
USER cags
WORKDIR /data
VOLUME /data
CMD ["cags-doctor", "--quick"]
