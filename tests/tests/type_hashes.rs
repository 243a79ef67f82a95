//! Type hashes against those that `rosbags`, an implementation of its own, computes from the interface files.
#![allow(clippy::unwrap_used, reason = "a test's own helpers may fail like the test")]

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;

use patchmill_msgs::{ActionType, RosType, ServiceType, TYPE_HASHES, action, for_every_message, srv};
use patchmill_tests::executables::peers_python;

/// The generator's own modules: hashes of types that no interface has yet.
#[path = "../../msgs/build/hash.rs"]
#[allow(dead_code)]
mod hash;
#[path = "../../msgs/build/parse.rs"]
#[allow(dead_code)]
mod parse;

fn folder(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(name)
}

/// Name and hash by `rosbags`.
fn by_rosbags(arguments: &[&Path]) -> BTreeMap<String, String> {
    let mut command = Command::new(peers_python());
    command.arg(folder("peers/type_hashes.py")).arg(folder("../msgs")).args(arguments);
    let output = command.output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).unwrap();
    text.lines()
        .map(|line| line.split_once(' ').unwrap())
        .map(|(n, h)| (n.to_owned(), h.to_owned()))
        .collect()
}

#[test]
fn every_interface_has_the_hash_of_rosbags() {
    let ours: BTreeMap<String, String> =
        TYPE_HASHES.iter().map(|(name, hash)| ((*name).to_owned(), (*hash).to_owned())).collect();
    assert_eq!(ours, by_rosbags(&[]));
    let files = |kind: &str| std::fs::read_dir(folder("../msgs").join(kind)).unwrap().count();
    let own = ours.keys().filter(|name| name.starts_with("patchmill_msgs/")).count();
    assert_eq!(own, files("msg") + 3 * files("srv") + 4 * files("action"));
}

#[test]
fn the_traits_carry_the_hashes() {
    let hashes: BTreeMap<&str, &str> = TYPE_HASHES.iter().copied().collect();
    macro_rules! check {
        ($name:literal, $path:path, [$($constant:ident),*]) => {{
            type T = $path;
            assert_eq!(hashes[$name], T::TYPE_HASH);
        }};
    }
    for_every_message!(check);
    assert_eq!(hashes["patchmill_msgs/srv/SolvePose"], srv::SolvePose::TYPE_HASH);
    assert_eq!(hashes["patchmill_msgs/srv/LoadProgram"], srv::LoadProgram::TYPE_HASH);
    assert_eq!(hashes["patchmill_msgs/action/PlanSurface"], action::PlanSurface::TYPE_HASH);
    assert_eq!(hashes["patchmill_msgs/action/ExecuteProgram"], action::ExecuteProgram::TYPE_HASH);
}

/// Every kind of field; wstring is left out because rosbags knows none in a .msg file.
const EVERY_KIND: &str = "
# A comment does not count, nor does a constant or a default value.
uint8 CONSTANT=3
bool a true
byte b
char c
int8 d
uint8 e 7
int16 f
uint16 g
int32 h
uint32 i
int64 j
uint64 k
float32 l
float64 m 1.5
string n
string<=12 o
float64[3] q
float64[] r
float64[<=5] s
string[2] t
string<=4[] u
string<=4[<=6] v
patchmill_msgs/Tool w
geometry_msgs/Point[] x
geometry_msgs/Point[<=9] y
patchmill_msgs/PatchPlan[4] z
";

fn hash_of(text: &str) -> String {
    let mut types = hash::Descriptions::default();
    let mut add = |name: &str, package: &str, text: &str| {
        let section = parse::Section::parse(text, package, Path::new("test"), 1).unwrap();
        types.add(name, &section.fields);
    };
    for (name, file) in [
        ("patchmill_msgs/msg/HolderSection", "msg/HolderSection.msg"),
        ("patchmill_msgs/msg/Tool", "msg/Tool.msg"),
        ("patchmill_msgs/msg/PatchPlan", "msg/PatchPlan.msg"),
        ("geometry_msgs/msg/Point", "standard/geometry_msgs/msg/Point.msg"),
        ("geometry_msgs/msg/Vector3", "standard/geometry_msgs/msg/Vector3.msg"),
    ] {
        let text = std::fs::read_to_string(folder("../msgs").join(file)).unwrap();
        add(name, name.split('/').next().unwrap(), &text);
    }
    add("patchmill_msgs/msg/EveryKind", "patchmill_msgs", text);
    types.hash("patchmill_msgs/msg/EveryKind").unwrap()
}

#[test]
fn every_kind_of_field_is_hashed_as_by_rosbags() {
    let root = tempfile::tempdir().unwrap();
    let file = root.path().join("EveryKind.msg");
    std::fs::write(&file, EVERY_KIND).unwrap();
    let theirs = by_rosbags(&[Path::new("patchmill_msgs/msg/EveryKind"), &file]);
    assert_eq!(theirs["patchmill_msgs/msg/EveryKind"], hash_of(EVERY_KIND));
}

#[test]
fn the_hash_follows_fields_and_nothing_else() {
    let hash = hash_of("uint8 a\nuint8 b\n");
    assert_eq!(hash, hash_of("# text\nuint8 C=1\nuint8 a 4 # more\n\nuint8   b\n"));
    for other in [
        "uint8 b\nuint8 a\n",
        "uint8 a\n",
        "uint8 a\nint8 b\n",
        "uint8 a\nuint8 c\n",
        "uint8 a\nuint8[1] b\n",
    ] {
        assert_ne!(hash, hash_of(other), "{other}");
    }
}
