# docker build -t gs . && docker run --rm -v "$PWD:/work" -u "$(id -u):$(id -g)" gs fly --mission cube8 --dry-run
FROM python:3.12-slim
ARG COMMIT=""
COPY . /src
RUN GS_COMMIT="$COMMIT" pip install --no-cache-dir "/src[all]" && rm -rf /src
ENV HOME=/tmp MPLCONFIGDIR=/tmp/matplotlib
WORKDIR /work
ENTRYPOINT ["gs"]
CMD ["--help"]
