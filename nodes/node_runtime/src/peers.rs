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
    /// Types that others have with another definition, of those that tell: their type hashes by name.
    pub other_types: BTreeMap<String, String>,
}

#[derive(Default)]
struct Seen {
    participants: BTreeSet<Gid>,
    nodes: BTreeMap<Gid, Vec<String>>,
    stages: BTreeMap<String, (String, Build)>,
    other_types: BTreeMap<String, String>,
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
    node.hear_heartbeats(move |name, Heartbeat { stage, build, .. }| {
        locked(&stages).stages.insert(name, (stage, build));
    })?;
    // What is not heard within the time is not there.
    let _ = tokio::time::timeout(listen, watch(&watcher, &seen)).await;
    let own = [node.gid(), Gid::from(watcher.domain_participant().guid())];
    node.shutdown().await;
    let Seen { mut participants, nodes, stages, other_types } = std::mem::take(&mut *locked(&seen));
    participants.retain(|gid| !own.contains(gid));
    let nodes = nodes.into_iter().filter(|(gid, _)| !own.contains(gid));
    let mut nodes: Vec<String> = nodes.flat_map(|(_, names)| names).collect();
    nodes.sort();
    Ok(Peers { participants: participants.len(), nodes, stages, other_types })
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
        if let Some((name, hash)) = other_type(&endpoint.type_name, &endpoint.user_data) {
            locked(seen).other_types.insert(name, hash);
        }
    }
}

/// Name and hash of a type that we have too, but with another hash; `user_data` is what rmw implementations tell with an endpoint.
fn other_type(dds_type: &str, user_data: &[u8]) -> Option<(String, String)> {
    let name = dds_type.strip_suffix('_')?.replace("::dds_::", "::").replace("::", "/");
    let told = String::from_utf8_lossy(user_data);
    let hash = told.split(';').find_map(|item| item.trim().strip_prefix("typehash="))?;
    let (_, ours) = TYPE_HASHES.iter().find(|(known, _)| *known == name)?;
    (hash != *ours).then(|| (name, hash.to_owned()))
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
    fn a_type_of_another_definition_is_told_apart() {
        let (name, hash) = TYPE_HASHES.iter().find(|(name, _)| *name == "patchmill_msgs/msg/Job").unwrap();
        let user_data = |hash: &str| format!("enclave=/;typehash={hash};").into_bytes();
        let dds = "patchmill_msgs::msg::dds_::Job_";
        assert_eq!(other_type(dds, &user_data(hash)), None);
        let other = "RIHS01_00";
        assert_eq!(other_type(dds, &user_data(other)), Some(((*name).to_owned(), other.to_owned())));
        assert_eq!(other_type(dds, b""), None);
        assert_eq!(other_type("other_msgs::msg::dds_::Job_", &user_data(other)), None);
    }
}
