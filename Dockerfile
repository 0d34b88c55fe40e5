# The dashboard, built once
FROM node:22-slim AS dashboard
WORKDIR /build/frontend
COPY frontend/package.json frontend/package-lock.json ./
RUN npm ci --no-audit --no-fund
COPY frontend ./
RUN npm run build

# The service as a wheel, in an environment of its own
FROM python:3.11-slim AS service
WORKDIR /build
RUN python -m venv /opt/graspwatch
COPY requirements.lock ./
RUN /opt/graspwatch/bin/pip install --no-cache-dir -r requirements.lock
COPY pyproject.toml README.md LICENSE ./
COPY config ./config
COPY acquisition ./acquisition
COPY estimator ./estimator
COPY app ./app
COPY graspwatch ./graspwatch
COPY --from=dashboard /build/app/static ./app/static
RUN /opt/graspwatch/bin/pip wheel --no-cache-dir --no-deps --wheel-dir wheels . \
    && /opt/graspwatch/bin/pip install --no-cache-dir --no-deps wheels/*.whl

# What runs: neither compiler nor sources nor package manager's cache; a root that may be read-only
FROM python:3.11-slim
RUN useradd --create-home --uid 10001 graspwatch \
    && install -d -o graspwatch /var/lib/graspwatch /var/cache/graspwatch
COPY --from=service /opt/graspwatch /opt/graspwatch
# Compiled filters are kept in the cache; what is compiled now is a volume's first content, for the processor of its kind
ENV PATH=/opt/graspwatch/bin:$PATH NUMBA_CACHE_DIR=/var/cache/graspwatch PYTHONDONTWRITEBYTECODE=1
USER 10001
WORKDIR /var/lib/graspwatch
RUN graspwatch run trapezoid_4hz --tissue liver --cycles 1
VOLUME ["/var/lib/graspwatch", "/var/cache/graspwatch"]
EXPOSE 8000
HEALTHCHECK --interval=10s --timeout=3s --start-period=60s \
    CMD ["python", "-c", "import urllib.request as r; r.urlopen('http://127.0.0.1:8000/api/health', timeout=2)"]
# Others can reach it, so it does not start before there is a token: docs/deploying.md
CMD ["graspwatch", "serve", "--host", "0.0.0.0", "--data", "/var/lib/graspwatch"]
