//! Who else is on the domain, and whether a stack of patchmill there is whole and of our build.

use std::collections::{BTreeMap, BTreeSet};

use patchmill_msgs::TYPE_HASHES;
use patchmill_node_runtime::topics::nodes;
use patchmill_node_runtime::{Build, Peers};

use super::Finding;

const PEERS: &str = "peers";
const STACK: &str = "stack";
const TYPES: &str = "message types";
/// So many names are listed.
const LISTED: usize = 12;

/// What is there, `own` being this build.
pub fn stack(domain: u16, peers: &Peers, own: &Build) -> Vec<Finding> {
    let mut findings = vec![present(domain, peers)];
    let mut stacks: BTreeMap<&str, Vec<(&str, &Build)>> = BTreeMap::new();
    for (name, (stage, build)) in &peers.stages {
        let namespace = name.rsplit_once('/').map_or("", |(namespace, _)| namespace);
        stacks.entry(namespace).or_default().push((stage, build));
    }
    if stacks.is_empty() {
        findings.push(Finding::good(
            STACK,
            format!("none on domain {domain}; `patchmill plan` starts its own, `patchmill up --domain {domain}` one to stay"),
        ));
    }
    findings.extend(stacks.iter().map(|(namespace, stages)| whole(domain, namespace, stages, own)));
    findings.extend(types(peers));
    findings
}

fn present(domain: u16, peers: &Peers) -> Finding {
    let Peers { participants, nodes, .. } = peers;
    if nodes.is_empty() {
        let found = match participants {
            0 => format!("nobody else is on domain {domain}"),
            some => format!("{some} DDS participants on domain {domain}, none with a ROS node"),
        };
        return Finding::good(PEERS, found);
    }
    let listed: Vec<&str> = nodes.iter().take(LISTED).map(String::as_str).collect();
    let more =
        if nodes.len() > LISTED { format!(" and {} more", nodes.len() - LISTED) } else { String::new() };
    let found = format!("{} nodes in {participants} participants: {}{more}", nodes.len(), listed.join(", "));
    let mut twice: Vec<&str> = nodes.windows(2).filter(|w| w[0] == w[1]).map(|w| w[0].as_str()).collect();
    twice.dedup();
    if twice.is_empty() {
        return Finding::good(PEERS, found);
    }
    let advice = format!(
        "{} runs more than once: end one, or give a stack a namespace or domain of its own",
        twice.join(", ")
    );
    Finding::doubtful(PEERS, found, advice)
}

/// Nothing where nobody tells hashes: patchmill's own nodes tell them together, as their build.
fn types(peers: &Peers) -> Option<Finding> {
    let ours: BTreeMap<&str, &str> = TYPE_HASHES.iter().copied().collect();
    let others = |(name, hashes): (&String, &BTreeSet<String>)| {
        let other = hashes.iter().find(|hash| ours.get(name.as_str()) != Some(&hash.as_str()))?;
        Some(format!("{name} ({other})"))
    };
    let different: Vec<String> = peers.types.iter().filter_map(others).collect();
    match (peers.types.len(), different.is_empty()) {
        (0, _) => None,
        (told, true) => {
            Some(Finding::good(TYPES, format!("{told} of ours are told by others, all defined as here")))
        }
        (_, false) => Some(Finding::bad(
            TYPES,
            format!("others on the domain define {} differently", different.join(", ")),
            "build the other side against this version's msgs/, or take another domain: its messages will not be understood",
        )),
    }
}

fn whole(domain: u16, namespace: &str, stages: &[(&str, &Build)], own: &Build) -> Finding {
    let missing: Vec<&str> =
        nodes::STAGES.into_iter().filter(|stage| stages.iter().all(|(there, _)| there != stage)).collect();
    let others: Vec<String> = stages
        .iter()
        .filter(|(_, build)| build.interfaces != own.interfaces)
        .map(|(stage, build)| match build.version.as_str() {
            "" => format!("{stage} (does not tell its version)"),
            version => format!("{stage} (version {version}, interfaces {})", build.interfaces),
        })
        .collect();
    if !others.is_empty() {
        return Finding::bad(
            STACK,
            format!(
                "{namespace}: {} of another build than this command ({}, interfaces {})",
                others.join(", "),
                own.version,
                own.interfaces
            ),
            "restart the stack from the same build as this command, or use that build's command",
        );
    }
    if !missing.is_empty() {
        return Finding::doubtful(
            STACK,
            format!("{namespace}: {} not there", missing.join(", ")),
            format!("start them on domain {domain} (launch_scripts/bringup.sh), or plan without --domain"),
        );
    }
    let version = |(stage, build): &(&str, &Build)| {
        (build.version != own.version).then(|| format!("{stage} {}", build.version))
    };
    let versions: Vec<String> = stages.iter().filter_map(version).collect();
    if versions.is_empty() {
        return Finding::good(
            STACK,
            format!("{namespace}: all stages, version {}, same interfaces", own.version),
        );
    }
    Finding::doubtful(
        STACK,
        format!("{namespace}: {}, this command {}; same interfaces", versions.join(", "), own.version),
        "they understand each other, but plans may differ from this version's",
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::terminal::Mood;

    fn running(stages: &[&str], build: &Build) -> Peers {
        let named = |stage: &&str| (format!("/patchmill/{stage}"), ((*stage).to_owned(), build.clone()));
        let stages: BTreeMap<_, _> = stages.iter().map(named).collect();
        Peers {
            participants: stages.len(),
            nodes: stages.keys().cloned().collect(),
            stages,
            ..Peers::default()
        }
    }

    #[test]
    fn a_stack_has_to_be_whole_and_of_our_build() {
        let own = Build::own();
        let of = |peers: &Peers| stack(3, peers, &own);
        let nobody = of(&Peers::default());
        assert!(nobody.iter().all(|f| f.state == Mood::Good), "{nobody:?}");
        let all = of(&running(&nodes::STAGES, &own));
        assert!(all[1].state == Mood::Good && all[1].found.contains("/patchmill: all stages"), "{all:?}");
        let some = of(&running(&nodes::STAGES[1..], &own));
        assert!(some[1].state == Mood::Doubtful && some[1].found.contains("surface_ingestion"), "{some:?}");
        for other in [Build::default(), Build { interfaces: "0".to_owned(), ..own.clone() }] {
            let other = of(&running(&nodes::STAGES, &other));
            assert!(other[1].state == Mood::Bad && other[1].found.contains("another build"), "{other:?}");
        }
        let newer = of(&running(&nodes::STAGES, &Build { version: "9.9".to_owned(), ..own.clone() }));
        assert!(newer[1].state == Mood::Doubtful && newer[1].found.contains("9.9"), "{newer:?}");
        assert!(nobody.iter().all(|f| f.check != TYPES), "{nobody:?}");
        let (name, hash) = TYPE_HASHES[0];
        for (hash, state) in [(hash, Mood::Good), ("RIHS01_0", Mood::Bad)] {
            let types = [(name.to_owned(), [hash.to_owned()].into())].into();
            let told = of(&Peers { types, ..Peers::default() });
            assert!(told.iter().any(|f| f.check == TYPES && f.state == state), "{told:?}");
        }
    }

    #[test]
    fn nodes_of_one_name_are_told() {
        let nodes = ["/a", "/b", "/b"].map(str::to_owned).to_vec();
        let finding = present(0, &Peers { participants: 3, nodes, ..Peers::default() });
        assert!(finding.state == Mood::Doubtful && finding.advice.starts_with("/b runs"), "{finding:?}");
    }
}
