# SPDX-License-Identifier: Apache-2.0
# The two commands in a container:
#     docker build --tag hydro . && docker run --rm --interactive --tty hydro make train
# With a bench: --device /dev/ttyUSB0 --group-add dialout --ulimit rtprio=50 --cap-add SYS_NICE (real-time scheduling).
FROM debian:bookworm-slim
RUN apt-get update \
    && apt-get install --yes --no-install-recommends \
        ca-certificates g++ git make procps python3 python3-dev python3-venv \
    && rm --recursive --force /var/lib/apt/lists/*
RUN useradd --create-home hydro
WORKDIR /home/hydro/hydro
RUN chown hydro: .
USER hydro
COPY --chown=hydro . .
RUN make setup
CMD ["make", "train"]
