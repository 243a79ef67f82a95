//! Shapes and clouds as messages.

use nalgebra::Point3;
use patchmill_msgs::builtin_interfaces::msg::Time;
use patchmill_msgs::geometry_msgs::msg::{Point, Pose, Quaternion, Vector3};
use patchmill_msgs::sensor_msgs::msg::{PointCloud2, PointField};
use patchmill_msgs::std_msgs::msg::{ColorRGBA, Header};
use patchmill_msgs::visualization_msgs::msg::{Marker, MarkerArray};
use patchmill_products::wire::provenance::FRAME;

use crate::cloud::{Cloud, POINT_BYTES};
use crate::shape::{Form, Frame, Shape, into_messages};

/// Link of the tool's tip.
const TOOL_FRAME: &str = "tool_tip";

/// The shapes as messages of at most [`crate::shape::MESSAGE_BYTES`]; the first one begins by deleting all older markers.
///
/// Markers are frame-locked: a viewer moves them with the newest transforms, whatever the stamp says of the plan's age.
pub(super) fn marker_arrays(shapes: Vec<Shape>, stamp: &Time) -> Vec<MarkerArray> {
    let mut messages: Vec<MarkerArray> = into_messages(shapes)
        .into_iter()
        .map(|shapes| MarkerArray { markers: shapes.into_iter().map(|s| marker(s, stamp)).collect() })
        .collect();
    let delete = Marker { action: Marker::DELETEALL, ..blank(Frame::Workpiece, stamp) };
    if let Some(first) = messages.first_mut() {
        first.markers.insert(0, delete);
    }
    messages
}

/// A marker that draws nothing yet, lifetime without end.
fn blank(frame: Frame, stamp: &Time) -> Marker {
    let frame = match frame {
        Frame::Workpiece => FRAME,
        Frame::ToolTip => TOOL_FRAME,
    };
    Marker {
        header: Header { stamp: stamp.clone(), frame_id: frame.to_owned() },
        pose: pose_at(0.0, 0.0, 0.0),
        frame_locked: true,
        ..Marker::default()
    }
}

fn marker(shape: Shape, stamp: &Time) -> Marker {
    let [r, g, b] = shape.colour;
    let marker = Marker {
        ns: shape.ns,
        id: shape.id,
        action: Marker::ADD,
        color: ColorRGBA { r, g, b, a: 1.0 },
        ..blank(shape.frame, stamp)
    };
    match shape.form {
        Form::Triangles(triangles) => Marker {
            r#type: Marker::TRIANGLE_LIST,
            scale: Vector3 { x: 1.0, y: 1.0, z: 1.0 },
            points: triangles.iter().flatten().map(point).collect(),
            ..marker
        },
        Form::Line { points, width } => Marker {
            r#type: Marker::LINE_STRIP,
            scale: Vector3 { x: width, y: 0.0, z: 0.0 },
            points: points.iter().map(point).collect(),
            ..marker
        },
        Form::Arrow { from, to, diameter } => Marker {
            r#type: Marker::ARROW,
            // Diameters of shaft and head, length of the head.
            scale: Vector3 { x: diameter, y: 2.5 * diameter, z: 4.0 * diameter },
            points: vec![point(&from), point(&to)],
            ..marker
        },
        Form::Text { at, height, text } => Marker {
            r#type: Marker::TEXT_VIEW_FACING,
            pose: pose_at(at.x, at.y, at.z),
            scale: Vector3 { x: 0.0, y: 0.0, z: height },
            text,
            ..marker
        },
        Form::Cylinder { middle, diameter, height } => Marker {
            r#type: Marker::CYLINDER,
            pose: pose_at(0.0, 0.0, middle),
            scale: Vector3 { x: diameter, y: diameter, z: height },
            ..marker
        },
    }
}

fn point(p: &Point3<f64>) -> Point {
    Point { x: p.x, y: p.y, z: p.z }
}

fn pose_at(x: f64, y: f64, z: f64) -> Pose {
    Pose { position: Point { x, y, z }, orientation: Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 } }
}

/// The cloud as a message; without points one that clears the viewer.
pub(super) fn point_cloud(cloud: Cloud, stamp: &Time) -> PointCloud2 {
    let field = |(place, name): (usize, &&str)| PointField {
        name: (*name).to_owned(),
        offset: 4 * place as u32,
        datatype: PointField::FLOAT32,
        count: 1,
    };
    PointCloud2 {
        header: Header { stamp: stamp.clone(), frame_id: FRAME.to_owned() },
        height: 1,
        width: cloud.count as u32,
        fields: cloud.entries().iter().enumerate().map(field).collect(),
        is_bigendian: false,
        point_step: POINT_BYTES as u32,
        row_step: cloud.data.len() as u32,
        data: cloud.data,
        is_dense: true,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shape::{MESSAGE_BYTES, MOST_POINTS};
    use patchmill_msgs::cdr::to_cdr;

    #[test]
    fn messages_are_as_small_as_the_shapes_promise() {
        let p = Point3::new(0.1, 0.2, 0.3);
        let forms = [
            Form::Triangles(vec![[p; 3]; MOST_POINTS / 3]),
            Form::Line { points: vec![p; MOST_POINTS], width: 1e-4 },
            Form::Arrow { from: p, to: p, diameter: 1e-3 },
            Form::Text { at: p, height: 0.01, text: "patch 12".to_owned() },
            Form::Cylinder { middle: 0.1, diameter: 0.1, height: 0.1 },
        ];
        for (id, form) in forms.into_iter().enumerate() {
            let shape = Shape::on_workpiece("feed_direction", id, [0.5; 3], form);
            let alone = MarkerArray { markers: vec![marker(shape.clone(), &Time::default())] };
            assert!(to_cdr(&alone).len() <= shape.bytes(), "{shape:?}");
        }
        let many = (0..300).map(|id| {
            let points = vec![p; 2 + (37 * id) % 900];
            Shape::on_workpiece("passes_0", id, [0.5; 3], Form::Line { points, width: 1e-4 })
        });
        let messages = marker_arrays(many.collect(), &Time::default());
        assert_eq!(messages.iter().map(|m| m.markers.len()).sum::<usize>(), 301);
        for message in &messages {
            assert!(to_cdr(message).len() <= MESSAGE_BYTES + 16);
        }
    }

    #[test]
    fn the_first_marker_deletes_and_no_other_does() {
        let shapes = (0..5000).map(|id| {
            let form = Form::Arrow { from: Point3::origin(), to: Point3::origin(), diameter: 1e-3 };
            Shape::on_workpiece("tool_axis", id, [0.1, 0.2, 0.3], form)
        });
        let stamp = Time { sec: 7, nanosec: 9 };
        let messages = marker_arrays(shapes.collect(), &stamp);
        assert!(messages.len() > 1);
        let all: Vec<&Marker> = messages.iter().flat_map(|m| &m.markers).collect();
        assert_eq!(all[0].action, Marker::DELETEALL);
        assert!(all[1..].iter().all(|m| m.action == Marker::ADD && m.color.a == 1.0 && m.frame_locked));
        assert!(all.iter().all(|m| m.header.stamp == stamp && m.pose.orientation.w == 1.0));
        let nothing = marker_arrays(Vec::new(), &stamp);
        assert_eq!(nothing.len(), 1);
        assert_eq!(nothing[0].markers.len(), 1);
    }

    #[test]
    fn the_cloud_message_describes_its_bytes() {
        let cloud = Cloud { number: "radius", count: 3, stride: 1, data: vec![7; 3 * POINT_BYTES] };
        let message = point_cloud(cloud, &Time::default());
        assert_eq!((message.width, message.height, message.point_step, message.row_step), (3, 1, 20, 60));
        let fields: Vec<(&str, u32)> = message.fields.iter().map(|f| (f.name.as_str(), f.offset)).collect();
        assert_eq!(fields, [("x", 0), ("y", 4), ("z", 8), ("radius", 12), ("rgb", 16)]);
        assert_eq!(message.row_step * message.height, message.data.len() as u32);
    }
}
