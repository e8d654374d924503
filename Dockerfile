# The studio behind a password, for other machines:
#   docker build -t bunraku .
#   docker run --rm -p 8734:8734 -e BUNRAKU_STUDIO_PASSWORD='a long password' -v bunraku:/data bunraku
FROM python:3.12.12-slim-bookworm AS wheels

# some packages come as sources alone, in C++
RUN apt-get update && apt-get install --yes --no-install-recommends g++
COPY pyproject.toml requirements.lock README.md LICENSE NOTICE /source/
COPY src /source/src
# the versions that were tested together
RUN pip wheel --no-cache-dir --constraint /source/requirements.lock --wheel-dir /wheels '/source[compressed,studio]'

FROM python:3.12.12-slim-bookworm

# a compiler for the loops that draw previews
RUN apt-get update && apt-get install --yes --no-install-recommends gcc libc6-dev \
    && rm -rf /var/lib/apt/lists/*

RUN --mount=type=bind,from=wheels,source=/wheels,target=/wheels \
    pip install --no-cache-dir --no-compile --no-index --find-links /wheels 'bunraku[compressed,studio]'

RUN useradd --create-home studio && mkdir /data && chown studio /data
USER studio
VOLUME /data
EXPOSE 8734
CMD ["bunraku", "studio", "--no-browser", "--host", "0.0.0.0", "--folder", "/data"]
