//! The data of a `sensor_msgs/PointCloud2` as the points of a scan.

use nalgebra::Point3;

use crate::raw::{Limits, RawCloud};
use crate::scalar::Scalar;

/// A field of a `sensor_msgs/PointField`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PointField<'a> {
    /// What it holds: x, y and z are read.
    pub name: &'a str,
    /// Bytes from the start of a point.
    pub offset: u32,
    /// Type: 1 int8, 2 uint8, 3 int16, 4 uint16, 5 int32, 6 uint32, 7 float32, 8 float64.
    pub datatype: u8,
    /// Numbers in the field.
    pub count: u32,
}

/// A `sensor_msgs/PointCloud2` without its header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PointCloud2<'a> {
    /// Rows.
    pub height: u32,
    /// Points of a row.
    pub width: u32,
    /// What a point is made of.
    pub fields: &'a [PointField<'a>],
    /// Byte order of `data`.
    pub is_bigendian: bool,
    /// Bytes of a point.
    pub point_step: u32,
    /// Bytes of a row.
    pub row_step: u32,
    /// The points, row by row.
    pub data: &'a [u8],
}

/// The points of `message`, in its unit (m by ROS convention) and order. Points with a coordinate that is not finite gave no return:
/// left out and counted.
///
/// # Errors
/// Fields without x, y and z, steps or data too short for them; no points; more than `limits` allows.
pub fn points(message: &PointCloud2<'_>, limits: &Limits) -> Result<RawCloud, String> {
    let step = message.point_step as usize;
    let axes = [axis(message, "x")?, axis(message, "y")?, axis(message, "z")?];
    let (width, height, row) = (message.width as usize, message.height as usize, message.row_step as usize);
    limits.check_points(width.saturating_mul(height), "PointCloud2")?;
    if row < width.saturating_mul(step) {
        return Err(format!(
            "the PointCloud2 has a row_step of {row} bytes; {width} points of {step} bytes do not fit"
        ));
    }
    if message.data.len() < row.saturating_mul(height) {
        return Err(format!(
            "the PointCloud2 is truncated: {height} rows of {row} bytes are stated, found {} bytes",
            message.data.len()
        ));
    }
    let mut cloud = RawCloud::default();
    for i in 0..height {
        for j in 0..width {
            let point = &message.data[i * row + j * step..][..step];
            let at = axes.map(|(offset, scalar)| {
                scalar.read(&point[offset..], message.is_bigendian).unwrap_or(f64::NAN)
            });
            cloud.add(Point3::from(at));
        }
    }
    if cloud.points.is_empty() {
        return Err(format!("the PointCloud2 has no points ({} without a return)", cloud.no_return));
    }
    Ok(cloud)
}

fn axis(message: &PointCloud2<'_>, name: &str) -> Result<(usize, Scalar), String> {
    let Some(field) = message.fields.iter().find(|f| f.name == name) else {
        return Err(format!("the PointCloud2 has no field \"{name}\""));
    };
    let types = [
        Scalar::I8,
        Scalar::U8,
        Scalar::I16,
        Scalar::U16,
        Scalar::I32,
        Scalar::U32,
        Scalar::F32,
        Scalar::F64,
    ];
    let scalar = usize::from(field.datatype).checked_sub(1).and_then(|k| types.get(k)).copied();
    let Some(scalar) = scalar.filter(|_| field.count == 1) else {
        return Err(format!(
            "the PointCloud2's field \"{name}\" is of datatype {} and count {}; 1 to 8 and 1 were expected",
            field.datatype, field.count
        ));
    };
    let offset = field.offset as usize;
    if offset.saturating_add(scalar.size()) > message.point_step as usize {
        return Err(format!(
            "the PointCloud2's field \"{name}\" at byte {offset} does not fit in a point of {} bytes",
            message.point_step
        ));
    }
    Ok((offset, scalar))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const LIMITS: Limits = Limits { triangles: 4, points: 6 };
    const FIELDS: [PointField<'static>; 4] = [
        PointField { name: "rgb", offset: 0, datatype: 7, count: 1 },
        PointField { name: "z", offset: 20, datatype: 3, count: 1 },
        PointField { name: "x", offset: 4, datatype: 7, count: 1 },
        PointField { name: "y", offset: 8, datatype: 8, count: 1 },
    ];

    fn data(big: bool) -> Vec<u8> {
        let mut data = Vec::new();
        for i in 0..4 {
            let x = if i == 3 { f32::NAN } else { i as f32 + 0.5 };
            let (y, z) = (f64::from(i) * 10.0, -100i16 * i as i16);
            data.extend([0; 4]);
            let parts = [
                x.to_le_bytes().to_vec(),
                y.to_le_bytes().to_vec(),
                [0; 4].to_vec(),
                z.to_le_bytes().to_vec(),
            ];
            parts.into_iter().for_each(|mut part| {
                if big {
                    part.reverse();
                }
                data.extend(part);
            });
            if i % 2 == 1 {
                data.extend([9; 3]);
            }
        }
        data
    }

    fn message(data: &[u8], is_bigendian: bool) -> PointCloud2<'_> {
        PointCloud2 { height: 2, width: 2, fields: &FIELDS, is_bigendian, point_step: 22, row_step: 47, data }
    }

    #[test]
    fn fields_rows_and_byte_orders_are_followed() {
        for big in [false, true] {
            let cloud = points(&message(&data(big), big), &LIMITS).unwrap();
            let expected = [[0.5, 0.0, 0.0], [1.5, 10.0, -100.0], [2.5, 20.0, -200.0]].map(Point3::from);
            assert_eq!((cloud.points.as_slice(), cloud.no_return), (&expected[..], 1));
        }
    }

    #[test]
    fn each_bad_message_is_one_clear_error() {
        let data = data(false);
        let good = message(&data, false);
        let mut wide = FIELDS;
        wide[3].offset = 15;
        let mut unknown = FIELDS;
        unknown[2].datatype = 9;
        for (bad, part) in [
            (PointCloud2 { fields: &FIELDS[..3], ..good }, "no field \"y\""),
            (PointCloud2 { fields: &wide, ..good }, "\"y\" at byte 15 does not fit in a point of 22"),
            (PointCloud2 { fields: &unknown, ..good }, "\"x\" is of datatype 9"),
            (PointCloud2 { row_step: 43, ..good }, "row_step of 43"),
            (PointCloud2 { data: &data[1..], ..good }, "truncated: 2 rows of 47 bytes are stated, found 93"),
            (
                PointCloud2 { width: u32::MAX, height: u32::MAX, ..good },
                "more than the 6 allowed (max_points)",
            ),
            (PointCloud2 { width: 0, ..good }, "no points"),
        ] {
            let error = points(&bad, &LIMITS).unwrap_err();
            assert!(error.contains(part), "{part}: {error}");
        }
    }

    proptest! {
        #[test]
        fn no_message_panics(
            data in prop::collection::vec(any::<u8>(), 0..100),
            sizes in prop::array::uniform4(prop_oneof![0u32..8, any::<u32>()]),
            offsets in prop::array::uniform3(prop_oneof![0u32..8, any::<u32>()]),
            datatype in 0u8..10,
        ) {
            let fields: Vec<_> = ["x", "y", "z"].iter().zip(offsets)
                .map(|(name, offset)| PointField { name, offset, datatype, count: 1 }).collect();
            let [height, width, point_step, row_step] = sizes;
            let _ = points(&PointCloud2 { height, width, fields: &fields, is_bigendian: false, point_step, row_step, data: &data }, &LIMITS);
        }
    }
}
