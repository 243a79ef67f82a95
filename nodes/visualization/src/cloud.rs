//! Points with a number and a colour each, as the bytes of a point cloud.

use nalgebra::Point3;

use crate::colours::Rgb;

/// Bytes of a point: x, y, z in m, a number, rgb, each four bytes.
pub const POINT_BYTES: usize = 20;
/// Most bytes of the points, so that one message stays below 120 KiB.
const MOST_BYTES: usize = 110 * 1024;

/// Points as bytes, little-endian `f32`; `rgb` is the colour 0x00RRGGBB in the bits of a float, as RViz expects it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Cloud {
    /// Name of the number between place and colour.
    pub number: &'static str,
    /// Number of points.
    pub count: usize,
    /// Every point stands for so many; 1 when none is left out.
    pub stride: usize,
    /// The points.
    pub data: Vec<u8>,
}

impl Cloud {
    /// Without points yet.
    pub fn new(number: &'static str, stride: usize) -> Self {
        Self { number, count: 0, stride, data: Vec::new() }
    }

    /// The stride at which so many points fit into one message: 1 up to 5632 of them.
    pub fn stride_of(points: usize) -> usize {
        (points * POINT_BYTES).div_ceil(MOST_BYTES).max(1)
    }

    /// Names of a point's entries in order.
    pub fn entries(&self) -> [&'static str; 5] {
        ["x", "y", "z", self.number, "rgb"]
    }

    /// Adds a point.
    pub fn push(&mut self, place: &Point3<f64>, number: f64, colour: Rgb) {
        let [r, g, b] = colour.map(|c| (c * 255.0).round() as u32);
        for number in [place.x as f32, place.y as f32, place.z as f32, number as f32] {
            self.data.extend(number.to_le_bytes());
        }
        self.data.extend((r << 16 | g << 8 | b).to_le_bytes());
        self.count += 1;
    }
}
