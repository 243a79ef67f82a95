//! Who is on a domain: what discovery tells within a while.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use futures::StreamExt;
use patchmill_msgs::TYPE_HASHES;
use ros2_client::builtin_topics::ros_discovery;
use ros2_client::dds::rustdds::{DomainParticipantStatusEvent, RTPSEntity, StatusEvented, TopicKind};
use ros2_client::entities_info::ParticipantEntitiesInfo;
use ros2_client::{Context, Gid, NodeName};

use crate::RuntimeError;
use crate::arguments::{Arguments, NodeOptions};
use crate::heartbeat::{Build, Heartbeat};
use crate::node::{Node, join};
use crate::parameters::ParameterSet;
use crate::qos::Qos;

/// Everybody else on a domain.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Peers {
    /// Number of DDS participants, ROS or not.
    pub participants: usize,
    /// Full names of the ROS nodes, in order; one that several have comes as often.
    pub nodes: Vec<String>,
    /// The stages of patchmill stacks that gave a sign of life, by the full name of their nodes.
    pub stages: BTreeMap<String, (String, Build)>,
    /// Types of ours whose hashes others tell with their topics, as ROS 2's own middleware does: all hashes that were told, by name.
    pub types: BTreeMap<String, BTreeSet<String>>,
}

#[derive(Default)]
struct Seen {
    participants: BTreeSet<Gid>,
    nodes: BTreeMap<Gid, Vec<String>>,
    stages: BTreeMap<String, (String, Build)>,
    types: BTreeMap<String, BTreeSet<String>>,
}

/// Joins a domain and listens for so long.
///
/// # Errors
/// When the domain cannot be joined.
pub async fn peers(arguments: Arguments, listen: Duration) -> Result<Peers, RuntimeError> {
    let seen = Arc::new(Mutex::new(Seen::default()));
    // A node of its own takes the events of its participant away.
    let watcher = join(&arguments)?;
    let options = NodeOptions { arguments, parameters: ParameterSet::new() };
    let node = Node::start(options)?;
    node.hear_nodes(Arc::clone(&seen))?;
    let stages = Arc::clone(&seen);
    node.hear_heartbeats(move |name, _, Heartbeat { stage, build, .. }| {
        if !stage.is_empty() {
            locked(&stages).stages.insert(name, (stage, build));
        }
    })?;
    // What is not heard within the time is not there.
    let _ = tokio::time::timeout(listen, watch(&watcher, &seen)).await;
    let own = [node.gid(), Gid::from(watcher.domain_participant().guid())];
    node.shutdown().await;
    let Seen { mut participants, nodes, stages, types } = std::mem::take(&mut *locked(&seen));
    participants.retain(|gid| !own.contains(gid));
    let nodes = nodes.into_iter().filter(|(gid, _)| !own.contains(gid));
    let mut nodes: Vec<String> = nodes.flat_map(|(_, names)| names).collect();
    nodes.sort();
    Ok(Peers { participants: participants.len(), nodes, stages, types })
}

fn locked(seen: &Mutex<Seen>) -> std::sync::MutexGuard<'_, Seen> {
    seen.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Takes in the events of DDS discovery, for ever.
async fn watch(context: &Context, seen: &Mutex<Seen>) {
    let participant = context.domain_participant();
    let listener = participant.status_listener();
    let mut events = listener.as_async_status_stream();
    while let Some(event) = events.next().await {
        let endpoint = match event {
            DomainParticipantStatusEvent::ParticipantDiscovered { dpd } => {
                locked(seen).participants.insert(Gid::from(dpd.guid));
                continue;
            }
            DomainParticipantStatusEvent::WriterDetected { writer } => writer,
            DomainParticipantStatusEvent::ReaderDetected { reader } => reader,
            _ => continue,
        };
        if let Some((name, hash)) = told_type(&endpoint.type_name, &endpoint.user_data) {
            locked(seen).types.entry(name).or_default().insert(hash);
        }
    }
}

/// Name and hash of a type that we have too; `user_data` is what rmw implementations tell with an endpoint: a sequence's length, then
/// `typehash=RIHS01_…;` among others.
fn told_type(dds_type: &str, user_data: &[u8]) -> Option<(String, String)> {
    let name = dds_type.strip_suffix('_')?.replace("::dds_::", "::").replace("::", "/");
    let told = String::from_utf8_lossy(user_data);
    let (_, hash) = told.split_once("typehash=")?;
    let hash = hash.split(';').next().unwrap_or(hash).to_owned();
    TYPE_HASHES.iter().any(|(known, _)| *known == name).then_some((name, hash))
}

impl Node {
    /// Takes in which nodes the participants of the domain have.
    fn hear_nodes(&self, seen: Arc<Mutex<Seen>>) -> Result<(), RuntimeError> {
        let what = ros_discovery::TOPIC_NAME;
        // Deeper than usual: all participants write to it, and a late joiner gets all at once.
        let topic = self.participant().create_topic(
            what.to_owned(),
            ros_discovery::TYPE_NAME.to_owned(),
            &Qos::Series.policies(false),
            TopicKind::NoKey,
        );
        let topic = topic.map_err(|e| RuntimeError::create(what, e))?;
        let subscription = self.with_node(what, |node| {
            node.create_subscription::<ParticipantEntitiesInfo>(&topic, None).map_err(|e| e.to_string())
        })?;
        self.spawn(async move {
            let mut told = std::pin::pin!(subscription.async_stream());
            while let Some(info) = told.next().await {
                // What cannot be read tells of nobody.
                let Ok((info, _)) = info else { continue };
                let full = |node: &ros2_client::entities_info::NodeEntitiesInfo| {
                    NodeName::new(node.namespace(), node.name())
                        .map_or_else(|_| node.name().to_owned(), |name| name.fully_qualified_name())
                };
                let names = info.nodes().iter().map(full).collect();
                locked(&seen).nodes.insert(info.gid(), names);
            }
        });
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hashes_of_our_types_are_heard() {
        let user_data = b"Q\0\0\0typehash=RIHS01_470f;\0\0\0";
        let told = told_type("patchmill_msgs::msg::dds_::Job_", user_data);
        assert_eq!(told, Some(("patchmill_msgs/msg/Job".to_owned(), "RIHS01_470f".to_owned())));
        assert_eq!(told_type("patchmill_msgs::msg::dds_::Job_", b""), None);
        assert_eq!(told_type("other_msgs::msg::dds_::Job_", user_data), None);
    }
}
