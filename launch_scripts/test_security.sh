#!/usr/bin/env bash
# The tests with SROS2: builds the workspace with the feature `security` in a folder of its own (target/security), runs node_runtime's tests of
# topics, services, actions and large products between nodes with keys, and has strangers try a stack with keys. Needs Debian's openssl, libssl-dev and pkg-config, and what test.sh --install brings. The last part of test.sh.
set -euo pipefail
cd "$(dirname "$0")/.."
if ! command -v openssl >/dev/null || ! pkg-config --exists openssl 2>/dev/null; then
  echo "test_security.sh: openssl, its headers or pkg-config (Debian packages openssl, libssl-dev, pkg-config) are missing" >&2; exit 1
fi
if [ ! -f target/ros_peers/env.sh ]; then
  echo "test_security.sh: rclpy is missing in target/ros_peers; run: launch_scripts/test.sh --install" >&2; exit 1
fi
export PATCHMILL_PEERS_PYTHON=${PATCHMILL_PEERS_PYTHON:-$PWD/target/peers/bin/python} PATCHMILL_ROS_ENV="$PWD/target/ros_peers/env.sh"
export CARGO_TARGET_DIR="$PWD/target/security"
cargo build --release --workspace --features security
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
bash launch_scripts/keystore.sh "$scratch" >/dev/null
# Both packages, here and below, so that rustdds is compiled with the same features.
packages=(--release -p patchmill_tests -p patchmill_node_runtime --features security)
ROS_SECURITY_ENABLE=true ROS_SECURITY_KEYSTORE="$scratch" cargo test "${packages[@]}" --test node --test large_products
cargo test "${packages[@]}" --test security
