#!/usr/bin/env bash
# The one test command: format, lints, rustdoc, all Rust tests, and the checks by real peers (rs274 of LinuxCNC, rosbags, mcap-ros2-support,
# rclpy on Fast DDS with patchmill_msgs built by colcon, Chromium), at last the same with SROS2 (a build of its own).
# usage: test.sh [--install]    --install: install missing peers (Debian packages need root) instead of stopping
set -euo pipefail
cd "$(dirname "$0")/.."
install=${1:-}
peers=${PATCHMILL_PEERS:-target/peers}

if ! command -v rs274 >/dev/null; then
  if [ "$install" != --install ]; then
    echo "test.sh: rs274 (Debian package linuxcnc-uspace) is missing; install it or run: $0 --install" >&2; exit 1
  fi
  apt-get update -q && DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends linuxcnc-uspace
fi
if ! command -v ip >/dev/null; then
  if [ "$install" != --install ]; then
    echo "test.sh: ip (Debian package iproute2, for the two hosts) is missing; install it or run: $0 --install" >&2; exit 1
  fi
  apt-get update -q && DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends iproute2
fi
if ! command -v groff >/dev/null; then
  if [ "$install" != --install ]; then
    echo "test.sh: groff (Debian package groff-base, for the manual pages) is missing; install it or run: $0 --install" >&2; exit 1
  fi
  apt-get update -q && DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends groff-base
fi
if ! command -v faketime >/dev/null; then
  if [ "$install" != --install ]; then
    echo "test.sh: faketime (Debian package faketime, for a clock that is set) is missing; install it or run: $0 --install" >&2; exit 1
  fi
  apt-get update -q && DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends faketime
fi
if ! command -v chromium >/dev/null || ! command -v chromedriver >/dev/null; then
  if [ "$install" != --install ]; then
    echo "test.sh: chromium or chromedriver (Debian packages chromium, chromium-driver, for the report) is missing; install them or run: $0 --install" >&2; exit 1
  fi
  apt-get update -q && DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends chromium chromium-driver
fi
if ! command -v openssl >/dev/null || ! pkg-config --exists openssl 2>/dev/null; then
  if [ "$install" != --install ]; then
    echo "test.sh: openssl, its headers or pkg-config (Debian packages openssl, libssl-dev, pkg-config, for SROS2) are missing; install them or run: $0 --install" >&2; exit 1
  fi
  apt-get update -q && DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends openssl libssl-dev pkg-config
fi
if ! "$peers/bin/python" -c 'import rosbags, mcap_ros2, selenium, PIL, websockets' 2>/dev/null; then
  if [ "$install" != --install ]; then
    echo "test.sh: $peers lacks the Python peers (tests/peers/requirements.txt); run: $0 --install" >&2; exit 1
  fi
  python3 -m venv "$peers" && "$peers/bin/pip" install -q -r tests/peers/requirements.txt
fi
export PATCHMILL_PEERS_PYTHON="$PWD/$peers/bin/python"
case "$peers" in /*) PATCHMILL_PEERS_PYTHON="$peers/bin/python";; esac
if [ "$install" != --install ] && [ ! -f target/ros_peers/env.sh ]; then
  echo "test.sh: rclpy is missing in target/ros_peers; run: $0 --install" >&2; exit 1
fi
bash launch_scripts/peers.sh
export PATCHMILL_ROS_ENV="$PWD/target/ros_peers/env.sh"

tools=target/tools
if ! "$tools/bin/cargo-deny" --version >/dev/null 2>&1; then
  if [ "$install" != --install ]; then
    echo "test.sh: $tools lacks cargo-deny (what may be in the build); run: $0 --install" >&2; exit 1
  fi
  cargo install cargo-deny --version 0.20.2 --locked --root "$tools"
fi

# The patched rustdds is the published crate but for what its PATCH.md says.
bash launch_scripts/check_rustdds.sh

"$tools/bin/cargo-deny" check bans licenses sources
cargo fmt --all --check
cargo clippy --release --workspace --all-targets -- -D warnings
RUSTDOCFLAGS="-D warnings" cargo doc --release --workspace --no-deps
cargo build --release --workspace
cargo test --release --workspace --no-fail-fast

bash launch_scripts/test_security.sh
