#!/usr/bin/env bash
# Measures the ROS side on this machine and prints the figures: large products between processes and to rclpy, what DDS costs a plan,
# discovery. Takes some minutes; run it on a quiet machine.
# usage: ros2_figures.sh [ENV_FILE]    ENV_FILE: sets up a Python with rclpy and patchmill_msgs (default target/ros_peers/env.sh, made by
#                                      launch_scripts/peers.sh); without it the Rust figures alone are measured
set -euo pipefail
cd "$(dirname "$0")/../.."
environment=${1:-target/ros_peers/env.sh}
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
cargo build --release --workspace --bins --examples
figures=target/release/examples/ros2_figures
if [ -f "$environment" ]; then
  # shellcheck disable=SC1090
  source "$environment"
  PATCHMILL_ROS_PYTHON=$(command -v python)
  export PATCHMILL_ROS_PYTHON
fi
# 2 · 708² triangles.
"$figures" bowl "$scratch/bowl_1M.stl" 708
echo "$(nproc) processors, $(uname -sr); load at the start: $(uptime)"
"$figures" discovery
"$figures" products
"$figures" overhead tests/fixtures/surface_1.json
"$figures" overhead "$scratch/bowl_1M.stl"
echo "load at the end: $(uptime)"
