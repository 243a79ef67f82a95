//! Points and vectors as messages.

use nalgebra::{Point3, Vector3};
use patchmill_msgs::geometry_msgs::msg;

pub(super) fn point_msg(p: &Point3<f64>) -> msg::Point {
    msg::Point { x: p.x, y: p.y, z: p.z }
}

pub(super) fn point(p: &msg::Point) -> Point3<f64> {
    Point3::new(p.x, p.y, p.z)
}

pub(super) fn vector_msg(v: &Vector3<f64>) -> msg::Vector3 {
    msg::Vector3 { x: v.x, y: v.y, z: v.z }
}

pub(super) fn vector(v: &msg::Vector3) -> Vector3<f64> {
    Vector3::new(v.x, v.y, v.z)
}
