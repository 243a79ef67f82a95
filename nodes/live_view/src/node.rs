//! The node shell: subscribes to every topic and serves them on a WebSocket.

use std::collections::HashMap;
use std::sync::Arc;

use foxglove::{Context, WebSocketServer, WebSocketServerHandle};
use patchmill_msgs::RosType;
use patchmill_msgs::diagnostic_msgs::msg::DiagnosticArray;
use patchmill_node_runtime::{
    LargeProduct, Node, NodeOptions, ParameterSet, Qos, RuntimeError, TopicVisitor, topics, visit_topics,
};

use crate::lane::{CatchUp, Lane};

/// The port that Foxglove offers unasked.
pub const DEFAULT_PORT: u16 = 8765;
/// Messages of streams that may wait for a slow client beside all latched ones; then the oldest are dropped.
const STREAM_BACKLOG: usize = 1024;

/// The parameters of the node.
pub fn parameters() -> ParameterSet {
    ParameterSet::new()
        .text(
            "address",
            "127.0.0.1",
            "address on which the WebSocket listens; 0.0.0.0: for other machines too",
        )
        .read_only()
        .integer(
            "port",
            i64::from(DEFAULT_PORT),
            0..=65_535,
            "its port; 0: any free one, which the log names",
        )
        .read_only()
}

/// Joins the domain and serves until the node is shut down.
///
/// # Errors
/// When the node cannot join the domain or the address and port cannot be listened to.
pub async fn start(options: NodeOptions) -> Result<Node, RuntimeError> {
    let node = Node::start(options)?;
    node.give_signs_of_life()?;
    match serve(&node).await {
        Ok(()) => Ok(node),
        Err(e) => {
            node.shutdown().await;
            Err(e)
        }
    }
}

async fn serve(node: &Node) -> Result<(), RuntimeError> {
    let (address, port) = (node.text("address")?, node.integer("port")?);
    let context = Context::new();
    let mut tap = Tap { node, context: &context, lanes: HashMap::new(), backlog: STREAM_BACKLOG };
    visit_topics(&mut tap)?;
    // Signs of life: in no bag, but of use to who watches.
    tap.topic::<DiagnosticArray>(topics::DIAGNOSTICS, Qos::Stream)?;
    let Tap { lanes, backlog, .. } = tap;
    let server = WebSocketServer::new()
        .name(format!("patchmill {} on ROS domain {}", node.namespace(), node.domain()))
        .bind(&address, u16::try_from(port).unwrap_or(DEFAULT_PORT))
        .message_backlog_size(backlog)
        .listener(Arc::new(CatchUp { lanes }))
        .context(&context)
        .start()
        .await
        .map_err(|e| refused(format!("a WebSocket on {address}:{port}"), e))?;
    let port = server.port();
    node.info(format!("Foxglove: open connection ws://{address}:{port}"));
    let server = Running { server: Some(server), _context: context };
    node.spawn(async move {
        let _server = server;
        std::future::pending().await
    });
    Ok(())
}

fn refused(what: String, reason: impl std::fmt::Display) -> RuntimeError {
    RuntimeError::Create { what, reason: reason.to_string() }
}

/// Taps what it is shown.
struct Tap<'a> {
    node: &'a Node,
    context: &'a Arc<Context>,
    lanes: HashMap<foxglove::ChannelId, Arc<Lane>>,
    /// So many messages may wait for a client: all that are latched, and some of the streams.
    backlog: usize,
}

impl TopicVisitor for Tap<'_> {
    fn topic<T: RosType>(&mut self, name: &str, qos: Qos) -> Result<(), RuntimeError> {
        let full = self.node.resolve(name);
        let lane =
            Lane::open::<T>(self.context, &full, qos).map_err(|e| refused(format!("channel {full}"), e))?;
        self.lanes.insert(lane.id(), Arc::clone(&lane));
        self.backlog += if qos.latched() { qos.depth() as usize } else { 0 };
        self.node.subscribe_with(name, qos, move |message: T| lane.pass_on(&message))?;
        Ok(())
    }

    /// The manifest: chunks mean nothing to a viewer.
    fn product<P: LargeProduct>(&mut self) -> Result<(), RuntimeError> {
        self.topic::<P::Manifest>(P::MANIFEST_TOPIC, Qos::Product)
    }
}

/// Ends the server when dropped: left alone it would run for ever.
struct Running {
    server: Option<WebSocketServerHandle>,
    /// The server itself holds it weakly.
    _context: Arc<Context>,
}

impl Drop for Running {
    fn drop(&mut self) {
        if let Some(server) = self.server.take() {
            // The clients' tasks say goodbye on their own.
            server.stop().detach_all();
        }
    }
}
