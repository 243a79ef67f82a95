//! What is drawn, as plain data, and how it is divided into messages.

use nalgebra::Point3;

use crate::colours::Rgb;

/// Most bytes of a message's shapes: with the message's own bytes one UDP datagram on the loopback still holds it.
pub const MESSAGE_BYTES: usize = 58 * 1024;

/// Bytes of a shape without its points and texts, rounded up.
const SHAPE_BYTES: usize = 400;
/// Bytes of a point.
const POINT_BYTES: usize = 24;

/// Most points of one shape, whole triangles; so many fit into a message beside another shape.
pub const MOST_POINTS: usize = 2304;

/// The frame that a shape's points are in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Frame {
    /// `workpiece`.
    Workpiece,
    /// `tool_tip`: origin at the tip, z along the tool axis to the spindle.
    ToolTip,
}

/// A shape's form, m.
#[derive(Clone, Debug, PartialEq)]
pub enum Form {
    /// Triangles, counter-clockwise as seen from the tool side.
    Triangles(Vec<[Point3<f64>; 3]>),
    /// A polyline of so wide a stroke.
    Line {
        /// Its points.
        points: Vec<Point3<f64>>,
        /// Width of the stroke.
        width: f64,
    },
    /// An arrow with a shaft so thick.
    Arrow {
        /// Its tail.
        from: Point3<f64>,
        /// Its tip.
        to: Point3<f64>,
        /// Diameter of the shaft.
        diameter: f64,
    },
    /// A text that faces the viewer.
    Text {
        /// Its middle.
        at: Point3<f64>,
        /// Height of a capital letter.
        height: f64,
        /// What it says.
        text: String,
    },
    /// A cylinder about z.
    Cylinder {
        /// Height of its middle over the frame's origin.
        middle: f64,
        /// Its diameter.
        diameter: f64,
        /// Its height.
        height: f64,
    },
}

/// One thing to draw. Namespace and id together are unique within a topic.
#[derive(Clone, Debug, PartialEq)]
pub struct Shape {
    /// Namespace: what a viewer can switch on and off.
    pub ns: String,
    /// Number within the namespace, from 0.
    pub id: i32,
    /// Frame of its points.
    pub frame: Frame,
    /// Its colour, opaque.
    pub colour: Rgb,
    /// Its form.
    pub form: Form,
}

impl Shape {
    /// A shape in the `workpiece` frame.
    pub fn on_workpiece(ns: &str, id: usize, colour: Rgb, form: Form) -> Self {
        Self { ns: ns.to_owned(), id: id as i32, frame: Frame::Workpiece, colour, form }
    }

    /// Bytes that it takes in a message, at most.
    pub fn bytes(&self) -> usize {
        let (points, text) = match &self.form {
            Form::Triangles(triangles) => (3 * triangles.len(), 0),
            Form::Line { points, .. } => (points.len(), 0),
            Form::Arrow { .. } => (2, 0),
            Form::Text { text, .. } => (0, text.len()),
            Form::Cylinder { .. } => (0, 0),
        };
        SHAPE_BYTES + self.ns.len() + text + POINT_BYTES * points
    }
}

/// Shapes, and what a person has to know of them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Drawing {
    /// The shapes.
    pub shapes: Vec<Shape>,
    /// In what they are less than what they stand for; empty when in nothing.
    pub note: String,
}

/// The shapes divided into messages of at most [`MESSAGE_BYTES`], in order. There is always a first message, with room for
/// what deletes the older shapes.
pub fn into_messages(shapes: Vec<Shape>) -> Vec<Vec<Shape>> {
    let (mut messages, mut filled) = (vec![Vec::new()], SHAPE_BYTES);
    for shape in shapes {
        let bytes = shape.bytes();
        if filled + bytes > MESSAGE_BYTES {
            messages.push(Vec::new());
            filled = 0;
        }
        filled += bytes;
        if let Some(message) = messages.last_mut() {
            message.push(shape);
        }
    }
    messages
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(id: usize, points: usize) -> Shape {
        let points = vec![Point3::origin(); points];
        Shape::on_workpiece("a", id, [0.0; 3], Form::Line { points, width: 1e-3 })
    }

    #[test]
    fn messages_keep_the_order_and_the_bound() {
        let shapes: Vec<Shape> = (0..200).map(|i| line(i, (37 * i) % MOST_POINTS + 1)).collect();
        let messages = into_messages(shapes.clone());
        assert!(messages.len() > 50);
        for message in &messages {
            assert!(message.iter().map(Shape::bytes).sum::<usize>() <= MESSAGE_BYTES);
        }
        assert_eq!(messages.concat(), shapes);
    }

    #[test]
    fn the_first_message_is_there_and_has_room_for_one_shape_more() {
        assert_eq!(into_messages(Vec::new()), [Vec::new()]);
        let largest = line(0, MOST_POINTS);
        assert!(largest.bytes() + SHAPE_BYTES <= MESSAGE_BYTES);
        assert_eq!(into_messages(vec![largest]).len(), 1);
    }
}
