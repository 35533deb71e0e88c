#!/usr/bin/env bash
# The peers that are Python packages, in an environment of their own: benchmarks/peers.py finds it.
# LIGGGHTS, Yade and Siconos are packages of the system (Debian: liggghts, yade, siconos, python3-siconos, python3-h5py).
set -euo pipefail
cd "$(dirname "$0")/.."
"${PYTHON:-python3}" -m venv .peers
.peers/bin/pip install --quiet --upgrade pip
for package in numpy mujoco compas-lmgc90 compas_cra; do
    .peers/bin/pip install --quiet "$package" || echo "could not install $package: benchmarks/peers.py goes without it"
done
