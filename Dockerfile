# jaxscan for the CPU, with the lab server and the viewer: docs/install.md says how to build and run it.
FROM python:3.11-slim AS wheel
WORKDIR /src
COPY pyproject.toml README.md LICENSE ./
COPY jaxscan jaxscan
COPY hardware hardware
RUN pip install --no-cache-dir build==1.6.1 && python -m build --wheel

FROM python:3.11-slim
# What OpenCV and the kernels of XLA need of the system.
RUN apt-get update \
 && apt-get install --no-install-recommends -y libgl1 libglib2.0-0 libgomp1 \
 && rm -rf /var/lib/apt/lists/*
COPY constraints.txt /tmp/
COPY --from=wheel /src/dist/*.whl /tmp/
RUN pip install --no-cache-dir --constraint /tmp/constraints.txt "$(ls /tmp/*.whl)[lab,plots,viewer]" && rm /tmp/*.whl
RUN useradd --create-home scanner && mkdir /lab /work && chown scanner /lab /work
USER scanner
WORKDIR /work
# What is compiled is kept beside the data of the lab.
ENV JAX_COMPILATION_CACHE_DIR=/lab/compiled
VOLUME ["/lab"]
EXPOSE 8003
# All addresses of the container, not of the machine: publish the port for this machine alone (-p 127.0.0.1:8003:8003).
CMD ["scanner", "serve", "--data", "/lab", "--host", "0.0.0.0", "--insecure", "--name", "localhost", "--name", "127.0.0.1"]
