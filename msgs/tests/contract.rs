//! Holds the generated types against the interface files, which a reader of its own reads here.
//!
//! A serde deserializer that invents one value for whatever it is asked writes down what a type is made of; the
//! same text made from the files must be equal. The bytes are held against those of another implementation.

#![allow(clippy::unwrap_used)]

mod file_reader;
mod type_recorder;

use std::collections::BTreeMap;

use file_reader::Files;
use patchmill_msgs::cdr::{from_cdr, to_cdr};
use patchmill_msgs::{RosType, for_every_message};

/// What Rust knows of a type: layout, constants, definition.
struct Known {
    layout: String,
    constants: Vec<(String, String)>,
    definition: &'static str,
}

fn known() -> BTreeMap<&'static str, Known> {
    let mut all = BTreeMap::new();
    macro_rules! add {
        ($name:literal, $path:path, [$($constant:ident),*]) => {{
            type T = $path;
            assert_eq!(T::TYPE_NAME, $name);
            let default = T::default();
            assert_eq!(from_cdr::<T>(&to_cdr(&default)).unwrap(), default, "{}", $name);
            let known = Known {
                layout: type_recorder::layout::<T>(),
                constants: vec![$((stringify!($constant).to_owned(), T::$constant.to_string())),*],
                definition: T::DEFINITION,
            };
            assert!(all.insert($name, known).is_none(), "{}", $name);
        }};
    }
    for_every_message!(add);
    all
}

#[test]
fn types_have_the_fields_and_constants_of_their_files() {
    let files = Files::read();
    let known = known();
    let names: Vec<&str> = known.keys().copied().collect();
    assert_eq!(files.names(), names);
    for (name, known) in &known {
        assert_eq!(known.layout, files.layout(name), "{name}");
        assert_eq!(known.constants, files.constants(name), "{name}");
    }
}

#[test]
fn definitions_carry_everything_that_a_reader_needs() {
    let files = Files::read();
    for (name, known) in known() {
        let separator = format!("{}\n", "=".repeat(80));
        let mut parts = known.definition.split(&separator);
        assert_eq!(parts.next().map(str::trim_end), Some(files.text(name).trim_end()), "{name}");
        let nested: Vec<String> = parts
            .map(|part| {
                let (first, text) = part.split_once('\n').unwrap();
                let nested = first.strip_prefix("MSG: ").unwrap().replace('/', "/msg/");
                assert_eq!(text.trim_end(), files.text(&nested).trim_end(), "{name}: {nested}");
                nested
            })
            .collect();
        let mut sorted = nested.clone();
        sorted.sort();
        assert_eq!(sorted, files.needs(name), "{name}");
    }
}

/// The bytes that Python's `rosbags` (an implementation of its own) gives this job; see `tests/job_cdr.py`.
#[test]
fn bytes_are_those_of_another_implementation() {
    use patchmill_msgs::geometry_msgs::msg::Vector3;
    use patchmill_msgs::msg::{HolderSection, Job, Tool};
    use patchmill_msgs::{builtin_interfaces, std_msgs};
    let job = Job {
        header: std_msgs::msg::Header {
            stamp: builtin_interfaces::msg::Time { sec: 7, nanosec: 8 },
            frame_id: "workpiece".into(),
        },
        job_id: "ab".into(),
        surface_id: "cdé".into(),
        tool: Tool {
            r1: 0.01305,
            r2: 0.006,
            length: 0.1,
            flute_length: 0.03,
            shank_radius: 0.008,
            holder: vec![HolderSection { length: 0.025, radius_low: 0.02, radius_high: 0.0315 }],
        },
        scallop_height: 25.4e-6,
        patches_min: 1,
        patches_max: 8,
        pattern: Job::PATTERN_ONE_WAY,
        acceleration_linear: 5.0,
        placement: Job::PLACEMENT_GIVEN,
        mount_position: Vector3 { x: 0.1, y: -0.2, z: 0.3 },
        mount_rpy: Vector3 { x: 0.0, y: 0.5, z: -1.5 },
        machine_urdf: "<robot/>".into(),
        ..Job::default()
    };
    let hex: String = to_cdr(&job).iter().map(|b| format!("{b:02x}")).collect();
    assert_eq!(hex, include_str!("job_cdr.hex").trim());
}

#[test]
fn broken_bytes_are_refused() {
    use patchmill_msgs::msg::Job;
    let whole = to_cdr(&Job { machine_urdf: "x".repeat(50), ..Job::default() });
    for cut in 0..whole.len() {
        assert!(from_cdr::<Job>(&whole[..cut]).is_err(), "{cut}");
    }
    let mut big_endian = whole.clone();
    big_endian[1] = 0;
    assert!(from_cdr::<Job>(&big_endian).unwrap_err().to_string().contains("little-endian"));
    let mut longer = whole.clone();
    longer.extend([0; 3]);
    assert!(from_cdr::<Job>(&longer).is_ok());
    longer.push(0);
    assert!(from_cdr::<Job>(&longer).is_err());
}

proptest::proptest! {
    #[test]
    fn any_bytes_are_a_message_or_an_error(mut bytes in proptest::collection::vec(proptest::num::u8::ANY, 4..400)) {
        bytes[..4].copy_from_slice(&[0, 1, 0, 0]);
        let _ = from_cdr::<patchmill_msgs::msg::ToolpathChunk>(&bytes);
        let _ = from_cdr::<patchmill_msgs::msg::SamplesChunk>(&bytes);
        let _ = from_cdr::<patchmill_msgs::visualization_msgs::msg::MarkerArray>(&bytes);
    }
}
