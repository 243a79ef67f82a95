//! The node shell: subscribes to every topic of patchmill and writes what comes.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant, SystemTime};

use patchmill_msgs::{RosType, cdr};
use patchmill_node_runtime::{
    JobTag, LargeProduct, Node, NodeOptions, ParameterSet, ProductEvent, ProductReceiver, Qos, Received,
    RuntimeError, TopicVisitor, visit_topics,
};
use tokio::sync::watch;

use crate::BagError;
use crate::buffer::{Dropped, Queued, Sender, buffer};
use crate::clock::Clock;
use crate::disk::write_all;
use crate::summary::BagSummary;
use crate::writer::{BagOptions, BagWriter, Topic};

/// The bag is complete when nothing has come for so long and no product is unfinished.
const QUIET: Duration = Duration::from_millis(500);
/// Longest wait for that.
const PATIENCE: Duration = Duration::from_secs(10);

/// A disk that is too slow is complained of at most so often.
const COMPLAINT_INTERVAL: Duration = Duration::from_secs(1);
const MIB: u64 = 1024 * 1024;

/// The parameters of the node.
pub fn parameters() -> ParameterSet {
    let default = RecorderOptions::default();
    ParameterSet::new()
        .text("directory", "bag", "directory of the bag; must not exist or be empty")
        .read_only()
        .integer(
            "max_bag_size_mib",
            default.max_file_mib as i64,
            0..=1_048_576,
            "a new file is begun before one has more MiB of data; 0: never",
        )
        .read_only()
        .integer(
            "buffer_mib",
            default.buffer_mib as i64,
            1..=65_536,
            "MiB that may wait for the disk; what finds no room is dropped and counted",
        )
        .read_only()
        .max_chunks()
}

/// How a run is recorded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RecorderOptions {
    /// A new file is begun before one has more MiB of data; 0: never.
    pub max_file_mib: u64,
    /// MiB that may wait for the disk; what finds no room is dropped and counted.
    pub buffer_mib: u64,
}

impl Default for RecorderOptions {
    fn default() -> Self {
        Self { max_file_mib: 0, buffer_mib: 256 }
    }
}

/// A running recorder. It never makes a publisher wait for the disk.
pub struct Recorder {
    node: Node,
    sink: Option<Sink>,
    writer: tokio::task::JoinHandle<Result<BagSummary, BagError>>,
    failure: watch::Receiver<Option<BagError>>,
}

#[derive(Clone)]
struct Sink {
    sender: Sender,
    counters: Arc<Counters>,
    clock: Clock,
    node: Node,
}

#[derive(Default)]
struct Counters {
    received: AtomicU64,
    /// Of `received`, those of streams: they never end, and a bag does not wait for their end.
    streamed: AtomicU64,
    pending: AtomicUsize,
    complained: Mutex<Option<Instant>>,
}

impl Sink {
    fn take<T: RosType>(&self, topic: &Arc<Topic>, message: &T) {
        let time = self.clock.at(Instant::now());
        self.counters.received.fetch_add(1, Ordering::Relaxed);
        let message = Queued { topic: Arc::clone(topic), time, bytes: cdr::to_cdr(message) };
        if let Err(dropped) = self.sender.push(message) {
            self.complain(dropped);
        }
    }

    fn complain(&self, dropped: Dropped) {
        let mut last = self.counters.complained.lock().unwrap_or_else(PoisonError::into_inner);
        if last.is_none_or(|at| at.elapsed() >= COMPLAINT_INTERVAL) {
            *last = Some(Instant::now());
            let Dropped { messages, bytes } = dropped;
            self.node
                .warn(format!("the disk is too slow: {messages} messages ({bytes} bytes) dropped so far"));
        }
    }
}

impl Recorder {
    /// Joins the domain and records into the directory of the parameter `directory`.
    ///
    /// # Errors
    /// When the node cannot start or the directory not be written.
    pub fn start(options: NodeOptions) -> Result<Self, RuntimeError> {
        let node = Node::start(options)?;
        let directory = PathBuf::from(node.text("directory")?);
        let options = RecorderOptions {
            max_file_mib: node.integer("max_bag_size_mib")? as u64,
            buffer_mib: node.integer("buffer_mib")? as u64,
        };
        Self::on(node, &directory, options)
    }

    /// Records with a node into a directory.
    ///
    /// # Errors
    /// As [`Recorder::start`].
    pub fn on(node: Node, directory: &Path, options: RecorderOptions) -> Result<Self, RuntimeError> {
        let bag =
            BagWriter::create_with(directory, BagOptions { max_file_bytes: options.max_file_mib * MIB })
                .map_err(|e| RuntimeError::Create { what: "the bag".to_owned(), reason: e.text })?;
        let (sender, queue) = buffer(options.buffer_mib * MIB);
        let (failed, failure) = watch::channel(None);
        let speaker = node.clone();
        let writer = tokio::task::spawn_blocking(move || {
            let written = write_all(bag, &queue);
            if let Err(e) = &written {
                speaker.error(format!("recording has ended: {e}"));
                failed.send_replace(Some(e.clone()));
            }
            written
        });
        node.give_signs_of_life()?;
        let clock = Clock::set(SystemTime::now(), Instant::now());
        let sink = Sink { sender, counters: Arc::default(), clock, node: node.clone() };
        visit_topics(&mut Subscriber { node: &node, sink: &sink })?;
        Ok(Self { node, sink: Some(sink), writer, failure })
    }

    /// Messages received so far.
    pub fn received(&self) -> u64 {
        self.sink.as_ref().map_or(0, |s| s.counters.received.load(Ordering::Relaxed))
    }

    /// Resolves when nothing more can be written (a full disk), with the reason; [`Recorder::finish`] says it again.
    pub async fn failed(&self) -> BagError {
        let mut failure = self.failure.clone();
        match failure.wait_for(Option::is_some).await {
            Ok(failure) => failure.clone().unwrap_or_else(broken),
            // The writer ended without a failure.
            Err(_) => std::future::pending().await,
        }
    }

    /// Ends the bag: waits until every announced product is whole and nothing has come for half a second (at most ten
    /// seconds), leaves the domain and returns when everything received is in the files.
    ///
    /// # Errors
    /// When the files could not be written.
    pub async fn finish(mut self) -> Result<BagSummary, BagError> {
        if let Some(sink) = self.sink.take()
            && self.failure.borrow().is_none()
        {
            settle(&sink.counters).await;
        }
        // Ends the subscriptions, and with them the last senders.
        self.node.shutdown().await;
        self.writer.await.unwrap_or_else(|_| Err(broken()))
    }
}

fn broken() -> BagError {
    BagError { text: "the bag's writer broke down".to_owned() }
}

impl Counters {
    /// Messages received but those of streams.
    fn finite(&self) -> u64 {
        let streamed = self.streamed.load(Ordering::Relaxed);
        self.received.load(Ordering::Relaxed).saturating_sub(streamed)
    }
}

async fn settle(counters: &Counters) {
    let end = Instant::now() + PATIENCE;
    let (mut seen, mut since) = (counters.finite(), Instant::now());
    while Instant::now() < end {
        tokio::time::sleep(Duration::from_millis(20)).await;
        let now = counters.finite();
        if now != seen || counters.pending.load(Ordering::Relaxed) > 0 {
            (seen, since) = (now, Instant::now());
        } else if since.elapsed() >= QUIET {
            return;
        }
    }
}

/// Subscribes to what it is shown.
struct Subscriber<'a> {
    node: &'a Node,
    sink: &'a Sink,
}

impl TopicVisitor for Subscriber<'_> {
    fn topic<T: RosType>(&mut self, name: &str, qos: Qos) -> Result<(), RuntimeError> {
        record::<T>(self.node, self.sink, name, qos)
    }

    fn product<P: LargeProduct>(&mut self) -> Result<(), RuntimeError> {
        record_product::<P>(self.node, self.sink)
    }
}

fn record<T: RosType>(node: &Node, sink: &Sink, name: &str, qos: Qos) -> Result<(), RuntimeError> {
    let topic = Arc::new(Topic::of::<T>(node.resolve(name), qos));
    let sink = sink.clone();
    node.subscribe_with(name, qos, move |message: T| {
        sink.counters.streamed.fetch_add(u64::from(qos == Qos::Stream), Ordering::Relaxed);
        sink.take(&topic, &message);
    })?;
    Ok(())
}

/// Manifests and chunks, those that come by the service too: the bag has every product whole.
fn record_product<P: LargeProduct>(node: &Node, sink: &Sink) -> Result<(), RuntimeError> {
    let manifest_topic = Arc::new(Topic::of::<P::Manifest>(node.resolve(P::MANIFEST_TOPIC), Qos::Product));
    let chunk_topic = Arc::new(Topic::of::<P::Chunk>(node.resolve(P::CHUNK_TOPIC), Qos::Chunks));
    let (sink, mut last) = (sink.clone(), 0);
    let mut products = ProductReceiver::<P>::observed(node, move |event| match event {
        ProductEvent::Manifest(manifest) => sink.take(&manifest_topic, manifest),
        ProductEvent::Chunk(chunk) => sink.take(&chunk_topic, chunk),
        ProductEvent::Pending(now) => {
            sink.counters.pending.fetch_add(now.wrapping_sub(last), Ordering::Relaxed);
            last = now;
        }
    })?;
    // The products themselves are not wanted; the receiver must live and be emptied.
    let speaker = node.clone();
    node.spawn(async move {
        while let Some(received) = products.next().await {
            if let Received::Failed { key, text } = received {
                let (what, of) = (P::WHAT, JobTag::of_key(&key).in_log());
                speaker.warn(format!("the bag does not have the {what} whole: {text}{of}"));
            }
        }
    });
    Ok(())
}
