//! The RViz configuration and the Foxglove layout: every topic that they name is one of the stack's, of a type that what shows it takes.
#![allow(clippy::unwrap_used, reason = "a test's own helpers may fail like the test")]

use std::collections::BTreeMap;
use std::path::Path;

use patchmill_msgs::RosType;
use patchmill_msgs::diagnostic_msgs::msg::DiagnosticArray;
use patchmill_node_runtime::{LargeProduct, Qos, RuntimeError, TopicVisitor, topics, visit_topics};
use serde_json::Value as Json;
use yaml_rust2::{Yaml, YamlLoader};

struct Topic {
    kind: &'static str,
    definition: &'static str,
    qos: Qos,
}

/// The stack's topics by absolute name.
#[derive(Default)]
struct Topics(BTreeMap<String, Topic>);

impl TopicVisitor for Topics {
    fn topic<T: RosType>(&mut self, name: &str, qos: Qos) -> Result<(), RuntimeError> {
        let absolute = if name.starts_with('/') { name.to_owned() } else { format!("/patchmill/{name}") };
        self.0.insert(absolute, Topic { kind: T::TYPE_NAME, definition: T::DEFINITION, qos });
        Ok(())
    }

    fn product<P: LargeProduct>(&mut self) -> Result<(), RuntimeError> {
        self.topic::<P::Manifest>(P::MANIFEST_TOPIC, Qos::Product)
    }
}

impl Topics {
    fn of_the_stack() -> Self {
        let mut topics = Self::default();
        visit_topics(&mut topics).unwrap();
        topics.topic::<DiagnosticArray>(topics::DIAGNOSTICS, Qos::Stream).unwrap();
        topics
    }

    fn get(&self, name: &str, kinds: &[&str]) -> &Topic {
        let topic = self.0.get(name).unwrap_or_else(|| panic!("there is no topic {name}"));
        assert!(kinds.contains(&topic.kind), "{name} is of type {}, {kinds:?} was expected", topic.kind);
        topic
    }

    fn check(&self, name: &str, kinds: &[&str]) {
        let _ = self.get(name, kinds);
    }

    /// `/topic.field` or `/topic.field[0]`: the topic has the field.
    fn check_path(&self, path: &str, kind: &str) {
        let (name, field) = path.split_once('.').unwrap_or_else(|| panic!("{path} names no field"));
        let own = self.get(name, &[kind]).definition.split("====").next().unwrap();
        let field = field.split(['[', '.']).next().unwrap();
        let has = own.lines().any(|line| line.split_whitespace().nth(1) == Some(field));
        assert!(has, "{name} has no field {field}");
    }
}

fn read(name: &str) -> String {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../launch_scripts/config");
    std::fs::read_to_string(folder.join(name)).unwrap()
}

const MARKERS: &str = "visualization_msgs/msg/MarkerArray";
const CLOUD: &str = "sensor_msgs/msg/PointCloud2";
const POSE: &str = "geometry_msgs/msg/PoseStamped";
const TEXT: &str = "std_msgs/msg/String";

#[test]
fn rviz_shows_topics_of_the_stack() {
    let topics = Topics::of_the_stack();
    let file = YamlLoader::load_from_str(&read("patchmill.rviz")).unwrap().remove(0);
    let displays = file["Visualization Manager"]["Displays"].as_vec().unwrap();
    let mut shown = Vec::new();
    for display in displays {
        let class = display["Class"].as_str().unwrap();
        let (topic, kind) = match class.trim_start_matches("rviz_default_plugins/") {
            // Listens to /tf and /tf_static, as everything in RViz.
            "TF" => continue,
            "RobotModel" => (&display["Description Topic"], TEXT),
            "MarkerArray" => (&display["Topic"], MARKERS),
            "PointCloud2" => (&display["Topic"], CLOUD),
            "Pose" => (&display["Topic"], POSE),
            other => panic!("a display of class {other}"),
        };
        let name = topic["Value"].as_str().unwrap();
        let qos = topics.get(name, &[kind]).qos;
        let durability = if qos.latched() { "Transient Local" } else { "Volatile" };
        assert_eq!(topic["Durability Policy"], Yaml::String(durability.to_owned()), "{name}");
        assert_eq!(topic["Reliability Policy"].as_str(), Some("Reliable"), "{name}");
        if qos.latched() {
            assert_eq!(topic["Depth"].as_i64(), Some(i64::from(qos.depth())), "{name}");
        }
        shown.push(name);
    }
    everything_to_see(&topics, &shown);
    assert_eq!(file["Visualization Manager"]["Global Options"]["Fixed Frame"].as_str(), Some("workpiece"));
}

#[test]
fn foxgloves_layout_shows_topics_of_the_stack() {
    let topics = Topics::of_the_stack();
    let layout: Json = serde_json::from_str(&read("patchmill_foxglove.json")).unwrap();
    let panels = layout["configById"].as_object().unwrap();
    let mut shown = Vec::new();
    for (id, panel) in panels {
        let text = |key: &str| panel[key].as_str().unwrap();
        match id.split('!').next().unwrap() {
            "3D" => {
                shown.extend(panel["topics"].as_object().unwrap().keys().map(String::as_str));
                shown.iter().for_each(|name| topics.check(name, &[MARKERS, CLOUD, POSE]));
                for layer in panel["layers"].as_object().unwrap().values() {
                    topics.check(layer["topic"].as_str().unwrap(), &[TEXT]);
                    shown.push(layer["topic"].as_str().unwrap());
                }
                assert_eq!(text("followTf"), "workpiece");
            }
            "Plot" => paths(panel).for_each(|path| topics.check_path(path, "sensor_msgs/msg/JointState")),
            "StateTransitions" => {
                let of_stages: Vec<String> =
                    topics::nodes::STAGES.iter().map(|s| format!("/patchmill/{s}/status.state")).collect();
                assert_eq!(paths(panel).collect::<Vec<_>>(), of_stages);
                paths(panel).for_each(|path| topics.check_path(path, "patchmill_msgs/msg/StageStatus"));
            }
            "RawMessages" => {
                topics.check(text("topicPath"), &["patchmill_msgs/msg/Evaluation", "patchmill_msgs/msg/Job"]);
            }
            "DiagnosticSummary" => {
                topics.check(text("topicToRender"), &["diagnostic_msgs/msg/DiagnosticArray"]);
            }
            other => panic!("a panel of type {other}"),
        }
    }
    everything_to_see(&topics, &shown);
    // Every panel stands in the layout, once, and no other.
    let mut placed = Vec::new();
    place(&layout["layout"], &mut placed);
    placed.sort_unstable();
    assert_eq!(placed, panels.keys().map(String::as_str).collect::<Vec<_>>());
}

fn paths(panel: &Json) -> impl Iterator<Item = &str> {
    panel["paths"].as_array().unwrap().iter().map(|path| path["value"].as_str().unwrap())
}

fn place<'a>(node: &'a Json, placed: &mut Vec<&'a str>) {
    match node.as_str() {
        Some(panel) => placed.push(panel),
        None => ["first", "second"].iter().for_each(|side| place(&node[side], placed)),
    }
}

/// All that the stack draws is shown, the machine too.
fn everything_to_see(topics: &Topics, shown: &[&str]) {
    let drawn = topics
        .0
        .keys()
        .filter(|name| name.contains("/visualization/") || name.ends_with("/robot_description"));
    let missing: Vec<&String> = drawn.filter(|name| !shown.contains(&name.as_str())).collect();
    assert!(missing.is_empty(), "not shown: {missing:?}");
}
