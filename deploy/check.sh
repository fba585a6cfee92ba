#!/usr/bin/env bash
# Checks what lies in deploy/, and the workflows, with the tools that will read it: promtool, kustomize, Envoy, hadolint, yamllint, cargo-deny, and
# the schemas of Kubernetes, Compose and CycloneDX.
# Usage: deploy/check.sh [PROGRAM]
# With a program, the dashboard and the alerts are asked of a real Prometheus, and Envoy stands before real servers.
# Needs Debian's package prometheus, with a program postgresql too, and Python 3.11 with venv; tests/python/venv.sh installs the other tools.
set -euo pipefail
cd "$(dirname "$0")/.."
program=${1:-}
venv=$(tests/python/venv.sh)

echo "-- YAML"
"$venv/bin/yamllint" --strict -c deploy/.yamllint.yaml deploy

echo "-- workflows, and versions of a release"
"$venv/bin/check-jsonschema" --quiet --builtin-schema vendor.github-workflows .github/workflows/*.yml
deploy/release/check_version.py

echo "-- Prometheus"
promtool check config deploy/prometheus/prometheus.yml
promtool check rules --lint=all --lint-fatal deploy/prometheus/alerts.yml
promtool test rules deploy/prometheus/alerts.test.yml

echo "-- Dockerfile"
# DL3008 asks for versions of Debian's packages, which Debian takes away when there are newer ones.
"$venv/bin/hadolint" --ignore DL3008 deploy/Dockerfile

echo "-- Envoy"
for file in deploy/envoy/*.yaml; do
    "$venv/bin/envoy" --mode validate --log-level error -c "$file"
done

echo "-- Compose"
"$venv/bin/check-jsonschema" --quiet --builtin-schema vendor.compose-spec deploy/compose*.yaml

echo "-- dashboard, Kubernetes, and how the files fit together"
python3 deploy/grafana/dashboard.py --check
"$venv/bin/python" deploy/check_files.py "$venv/bin/kubectl"

echo "-- packages"
"$venv/bin/cargo-deny" --locked check licenses bans sources

if [ -n "$program" ]; then
    echo "-- a real Prometheus"
    "$venv/bin/python" deploy/check_queries.py "$program"
    echo "-- a real Envoy"
    "$venv/bin/python" deploy/check_envoy.py "$program" "$venv/bin/envoy"
fi
