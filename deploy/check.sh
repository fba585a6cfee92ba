#!/usr/bin/env bash
# Checks what lies in deploy/ with the tools that will read it. Needs promtool and Python with venv.
#
#   deploy/check.sh [PROGRAM]     with a program, the dashboard and the rules are asked of a real Prometheus that watches it
set -euo pipefail
cd "$(dirname "$0")/.."
program=${1:-}

promtool check config deploy/prometheus/prometheus.yml
promtool test rules deploy/prometheus/alerts.test.yml

if [ ! -x target/deploy-venv/bin/kubernetes-validate ]; then
    python3 -m venv target/deploy-venv
    target/deploy-venv/bin/pip install --quiet --disable-pip-version-check -r deploy/requirements.txt
fi
target/deploy-venv/bin/python deploy/check_files.py
if [ -n "$program" ]; then
    target/deploy-venv/bin/python deploy/check_queries.py "$program"
fi
