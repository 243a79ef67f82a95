//! The READMEs' tables against the code: every parameter of every node with its default and unit, every error code, every topic.
#![allow(clippy::unwrap_used, reason = "a test's own helpers may fail like the test")]

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use patchmill_msgs::RosType;
use patchmill_node_runtime::{
    LargeProduct, Qos, RuntimeError, TopicVisitor, Value, stage_runner, topics, visit_topics,
};
use patchmill_planner::node_parameters::declared;
use patchmill_products::stage;
use patchmill_tests::markdown::{entries, repository, texts};

fn read(file: &str) -> String {
    std::fs::read_to_string(repository().join(file)).unwrap_or_else(|e| panic!("{file}: {e}"))
}

/// Rows of the tables whose head begins so, as cells.
fn rows(text: &str, head: &str) -> Vec<Vec<String>> {
    let mut rows = Vec::new();
    let mut within = false;
    for line in text.lines() {
        if line.starts_with(head) {
            within = true;
        } else if !line.starts_with('|') {
            within = false;
        } else if within && !line.starts_with("|---") {
            rows.push(line.trim_matches('|').split('|').map(|cell| cell.trim().to_owned()).collect());
        }
    }
    rows
}

/// The words between backticks.
fn quoted(cell: &str) -> Vec<&str> {
    cell.split('`').skip(1).step_by(2).collect()
}

fn shown(default: &Value) -> String {
    match default {
        Value::Text(text) if text.is_empty() => "(empty)".to_owned(),
        Value::Text(text) => format!("`{text}`"),
        other => other.to_string(),
    }
}

/// The unit that a name ends in.
fn unit(name: &str) -> &'static str {
    let units = [("_mm", "mm"), ("_s", "s"), ("_hz", "Hz"), ("_mib", "MiB")];
    units.iter().find(|(end, _)| name.ends_with(end)).map_or("", |(_, unit)| unit)
}

#[test]
fn every_parameter_has_its_row() {
    for (node, set) in declared() {
        let found: Vec<[String; 3]> = rows(&read(&format!("nodes/{node}/README.md")), "| parameter |")
            .into_iter()
            .map(|cells| {
                assert!(cells.len() == 4 && cells[3].len() >= 10, "{node}: {cells:?} says nothing");
                [cells[0].clone(), cells[1].clone(), cells[2].clone()]
            })
            .collect();
        let declared: Vec<[String; 3]> = set
            .defaults()
            .map(|(name, default)| [format!("`{name}`"), shown(default), unit(name).to_owned()])
            .collect();
        let (mut found, mut declared) = (found, declared);
        found.sort();
        declared.sort();
        assert_eq!(found, declared, "nodes/{node}/README.md beside what the node declares");
    }
}

/// All sources of a crate.
fn sources(folder: &Path) -> Vec<String> {
    let mut all = Vec::new();
    for path in entries(folder) {
        if path.is_dir() {
            all.extend(sources(&path));
        } else if path.extension().is_some_and(|e| e == "rs") {
            all.push(std::fs::read_to_string(path).unwrap());
        }
    }
    all
}

/// Values of the constants that are a stage's error codes: `const NAME: i32 = 110;`.
fn codes_of(source: &str) -> impl Iterator<Item = i32> {
    source.lines().filter_map(|line| {
        let (_, value) = line.split_once("const ")?.1.split_once(": i32 = ")?;
        value.strip_suffix(';')?.parse().ok().filter(|code| (100..800).contains(code))
    })
}

/// The codes under which products are refused, one a stage.
#[derive(Default)]
struct OfProducts(BTreeSet<i32>);

impl TopicVisitor for OfProducts {
    fn topic<T: RosType>(&mut self, _name: &str, _qos: Qos) -> Result<(), RuntimeError> {
        Ok(())
    }

    fn product<P: LargeProduct>(&mut self) -> Result<(), RuntimeError> {
        self.0.insert(P::CODE);
        Ok(())
    }
}

#[test]
fn every_error_code_has_its_row() {
    let stages = topics::nodes::STAGES.into_iter().chain([topics::nodes::PLANNER]);
    let hundreds: BTreeMap<i32, &str> = (1..).zip(stages).collect();
    let mut products = OfProducts::default();
    visit_topics(&mut products).unwrap();
    let mut count = 0;
    for (hundred, node) in hundreds {
        let all = sources(&repository().join("nodes").join(node).join("src"));
        let mut known: BTreeSet<i32> = all.iter().flat_map(|source| codes_of(source)).collect();
        assert!(
            known.iter().all(|code| code / 100 == hundred),
            "{node}: {known:?} are not all of its hundred"
        );
        known.extend(products.0.iter().filter(|code| **code / 100 == hundred));
        let file = format!("nodes/{node}/README.md");
        let mut told = BTreeSet::new();
        for cells in rows(&read(&file), "| code |") {
            for number in
                cells[0].split(',').filter_map(|n| n.trim().parse::<i32>().ok()).filter(|n| *n >= 100)
            {
                assert!(told.insert(number), "{file} has {number} twice");
            }
        }
        assert_eq!(told, known, "{file} beside the code");
        count += known.len();
    }
    assert!(count > 40, "{count} codes found");
    let any: Vec<String> = rows(&read("nodes/node_runtime/README.md"), "| code of any stage |")
        .into_iter()
        .map(|c| c[0].clone())
        .collect();
    assert_eq!(any, [stage::SUPERSEDED, stage_runner::INTERNAL].map(|code| code.to_string()));
}

/// All names of topics, without namespace.
#[derive(Default)]
struct Names(BTreeSet<String>);

impl TopicVisitor for Names {
    fn topic<T: RosType>(&mut self, name: &str, _qos: Qos) -> Result<(), RuntimeError> {
        self.0.insert(name.to_owned());
        Ok(())
    }

    fn product<P: LargeProduct>(&mut self) -> Result<(), RuntimeError> {
        self.0.extend([P::MANIFEST_TOPIC, P::CHUNK_TOPIC].map(str::to_owned));
        Ok(())
    }
}

/// Types, QoS and who publishes are held against a running stack by `peers/introspection.py`; here that nothing is missing.
#[test]
fn every_topic_has_its_row() {
    let mut known = Names::default();
    visit_topics(&mut known).unwrap();
    known.0.insert(topics::DIAGNOSTICS.to_owned());
    let mut told = BTreeSet::new();
    for cells in rows(&read("msgs/README.md"), "| name | type | from | QoS |")
        .iter()
        .filter(|cells| !cells[3].is_empty())
    {
        let names = quoted(&cells[0]);
        for name in &names {
            match (name.strip_prefix('…'), name.strip_prefix("<node>/")) {
                (Some(end), _) => drop(told.insert(format!("{}{end}", names[0]))),
                (_, Some(end)) => told.extend(topics::nodes::STAGES.map(|stage| format!("{stage}/{end}"))),
                _ => drop(told.insert((*name).to_owned())),
            }
        }
    }
    assert_eq!(told, known.0);
    // Every one is given by the node that its README names, and by one node only but for what all give.
    let mut given: BTreeMap<String, usize> = BTreeMap::new();
    for (node, _) in declared() {
        for cells in
            rows(&read(&format!("nodes/{node}/README.md")), "| | under").iter().filter(|c| c[0] == "gives")
        {
            quoted(&cells[1]).into_iter().for_each(|name| *given.entry(name.to_owned()).or_default() += 1);
        }
    }
    assert_eq!(given.remove(topics::DIAGNOSTICS), Some(declared().len()));
    assert!(given.values().all(|nodes| *nodes == 1), "{given:?}");
    known.0.remove(topics::DIAGNOSTICS);
    assert_eq!(given.into_keys().collect::<BTreeSet<_>>(), known.0);
}

/// Every package has a README, and it says what it holds.
#[test]
fn every_package_has_a_readme() {
    let mut packages = entries(&repository().join("nodes"));
    packages.extend(["msgs", "tests", "launch_scripts"].map(|name| repository().join(name)));
    assert!(packages.len() >= 17);
    for package in packages.iter().filter(|path| path.is_dir()) {
        let text = std::fs::read_to_string(package.join("README.md"))
            .unwrap_or_else(|e| panic!("{}: {e}", package.display()));
        assert!(text.starts_with("# ") && text.len() > 300, "{}", package.display());
    }
}

/// Links between the files lead somewhere.
#[test]
fn links_lead_to_files() {
    for file in texts() {
        let text = std::fs::read_to_string(&file).unwrap();
        for target in text.split("](").skip(1).filter_map(|rest| rest.split(')').next()) {
            let path = target.split('#').next().unwrap();
            if target.contains("://") || path.is_empty() {
                continue;
            }
            let to = file.parent().unwrap().join(path);
            assert!(to.exists(), "{} links to {target}", file.display());
        }
    }
}
