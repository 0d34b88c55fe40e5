# The dashboard, built once
FROM node:22-slim AS dashboard
WORKDIR /build/frontend
COPY frontend/package.json frontend/package-lock.json ./
RUN npm ci --no-audit --no-fund
COPY frontend ./
RUN npm run build

# The service
FROM python:3.11-slim
RUN useradd --create-home --uid 10001 graspwatch
WORKDIR /opt/graspwatch
COPY requirements.lock ./
RUN pip install --no-cache-dir -r requirements.lock
COPY pyproject.toml README.md LICENSE ./
COPY config ./config
COPY acquisition ./acquisition
COPY estimator ./estimator
COPY app ./app
COPY --from=dashboard /build/app/static ./app/static
RUN pip install --no-cache-dir --no-deps .
USER graspwatch
# compiled filters are kept here; compiling them now makes the first start a warm one
ENV NUMBA_CACHE_DIR=/home/graspwatch/.cache/numba
WORKDIR /home/graspwatch
RUN graspwatch run trapezoid_4hz --tissue liver && mkdir graspwatch-data
# Others can reach it, so it does not start before there is a token; keep the data folder in a volume:
# docker run --rm -v graspwatch-data:/home/graspwatch/graspwatch-data IMAGE graspwatch token add NAME --role admin
EXPOSE 8000
HEALTHCHECK --interval=10s --timeout=3s --start-period=60s \
    CMD python -c "import urllib.request; urllib.request.urlopen('http://127.0.0.1:8000/api/health', timeout=2)"
CMD ["graspwatch", "serve", "--host", "0.0.0.0"]
