//! The receiver of a large product: manifest topic, chunk topic and, for what is missing, the chunk service.

use std::sync::Arc;
use std::time::Duration;

use patchmill_products::wire::{Assembly, MAX_CHUNKS};
use tokio::sync::mpsc;
use tokio::time::Instant;

use crate::RuntimeError;
use crate::node::{AbortOnDrop, Node, Subscription};
use crate::parameters::ParameterSet;
use crate::products::{LargeProduct, ProductKey};
use crate::qos::Qos;
use crate::service::ServiceClient;

/// Missing chunks are asked for when none has come for so long.
const QUIET: Duration = Duration::from_millis(300);
/// One attempt of the service, and all attempts for one chunk.
const ATTEMPT: Duration = Duration::from_millis(500);
const DEADLINE: Duration = Duration::from_secs(2);
/// Rounds of asking in a row that brought nothing, before a product is given up.
const ROUNDS: u32 = 6;
/// Chunks asked for in one round.
const BATCH: usize = 64;
/// Times that a product may come whole but wrong before it is given up.
const INVALID: u32 = 2;
/// Products whose chunks have come but no manifest.
const ORPHANS: usize = 16;
/// Parameter of every node that receives products.
const LIMIT: &str = "max_chunks";
/// Its default: 880 MB.
const DEFAULT_LIMIT: i64 = 16_384;

/// What a receiver hands over.
pub enum Received<P: LargeProduct> {
    /// A whole and valid product.
    Product {
        /// Which it is.
        key: ProductKey,
        /// What announced it.
        manifest: Box<P::Manifest>,
        /// The product.
        product: P,
    },
    /// A product was announced but did not come whole, or is not valid.
    Failed {
        /// Which it is.
        key: ProductKey,
        /// What is missing or wrong.
        text: String,
    },
}

/// What an observer of a receiver sees: every message, once but for chunks that found no room before their manifest came.
pub enum ProductEvent<'a, P: LargeProduct> {
    /// A manifest.
    Manifest(&'a P::Manifest),
    /// A chunk, from the topic or from the service.
    Chunk(&'a P::Chunk),
    /// So many products are announced and neither whole nor given up; sent when that may have changed.
    Pending(usize),
}

impl ParameterSet {
    /// The parameter `max_chunks`, for nodes that receive products: most chunks (54 KiB each) of one.
    #[must_use]
    pub fn max_chunks(self) -> Self {
        let text = "most chunks, 54 KiB each, of a mesh, a toolpath or whatever else is received in chunks";
        self.integer(LIMIT, DEFAULT_LIMIT, 1..=MAX_CHUNKS.into(), text)
    }
}

/// Receives every product of a kind, but for those with more chunks than the node's parameter `max_chunks`, which fail. A newer run (other surface, job or stamp) lets go of an unfinished older one.
pub struct ProductReceiver<P: LargeProduct> {
    receiver: mpsc::UnboundedReceiver<Received<P>>,
    _task: AbortOnDrop,
}

impl<P: LargeProduct> ProductReceiver<P> {
    /// Subscribes.
    ///
    /// # Errors
    /// As [`Node::subscribe`] and [`Node::service_client`].
    pub fn new(node: &Node) -> Result<Self, RuntimeError> {
        Self::observed(node, |_| {})
    }

    /// Subscribes, and shows every message to an observer (the bag recorder).
    ///
    /// # Errors
    /// As [`ProductReceiver::new`].
    pub fn observed(
        node: &Node,
        observe: impl FnMut(ProductEvent<'_, P>) + Send + 'static,
    ) -> Result<Self, RuntimeError> {
        let (sender, receiver) = mpsc::unbounded_channel();
        let task = Task::new(node, sender, Box::new(observe))?;
        let task = AbortOnDrop(node.spawn(task.run()));
        Ok(Self { receiver, _task: task })
    }

    /// The next product; `None` once the node has been shut down. Cancel-safe.
    pub async fn next(&mut self) -> Option<Received<P>> {
        self.receiver.recv().await
    }
}

/// Answers of one round of asking.
struct Round<P: LargeProduct> {
    key: ProductKey,
    chunks: Vec<P::Chunk>,
    failure: Option<String>,
}

struct Entry<P: LargeProduct> {
    assembly: Assembly<P>,
    /// Ask when this has passed.
    due: Instant,
    asking: bool,
    fruitless: u32,
    invalid: u32,
    settled: bool,
    /// Given up: another manifest (of a sender that came back) is a new chance.
    failed: bool,
}

type Observer<P> = Box<dyn FnMut(ProductEvent<'_, P>) + Send>;

struct Task<P: LargeProduct> {
    manifests: Subscription<P::Manifest>,
    chunks: Subscription<P::Chunk>,
    client: Arc<ServiceClient<P::GetChunk>>,
    entries: Vec<Entry<P>>,
    sender: mpsc::UnboundedSender<Received<P>>,
    answers: mpsc::UnboundedSender<Round<P>>,
    filled: mpsc::UnboundedReceiver<Round<P>>,
    observe: Observer<P>,
    node: Node,
}

impl<P: LargeProduct> Task<P> {
    fn new(
        node: &Node,
        sender: mpsc::UnboundedSender<Received<P>>,
        observe: Observer<P>,
    ) -> Result<Self, RuntimeError> {
        let (answers, filled) = mpsc::unbounded_channel();
        Ok(Self {
            manifests: node.subscribe(P::MANIFEST_TOPIC, Qos::Product)?,
            chunks: node.subscribe(P::CHUNK_TOPIC, Qos::Chunks)?,
            client: Arc::new(node.service_client::<P::GetChunk>(P::SERVICE_NAME)?),
            entries: Vec::new(),
            sender,
            answers,
            filled,
            observe,
            node: node.clone(),
        })
    }

    async fn run(mut self) {
        loop {
            let due = self.entries.iter().filter(|e| e.is_waiting()).map(|e| e.due).min();
            let timer = async {
                match due {
                    Some(due) => tokio::time::sleep_until(due).await,
                    None => std::future::pending().await,
                }
            };
            tokio::select! {
                manifest = self.manifests.next() => match manifest {
                    Some(manifest) => self.take_manifest(manifest),
                    None => break,
                },
                chunk = self.chunks.next() => match chunk {
                    Some(chunk) => self.take_chunk(chunk),
                    None => break,
                },
                Some(round) = self.filled.recv() => self.take_round(round),
                () = timer => self.ask(),
            }
        }
    }

    /// Most chunks of a product.
    fn limit(&self) -> i64 {
        // Without the parameter, as in a program's own short-lived node, its default.
        self.node.integer(LIMIT).unwrap_or(DEFAULT_LIMIT)
    }

    fn take_manifest(&mut self, manifest: P::Manifest) {
        let key = P::manifest_key(&manifest);
        let (count, limit) = (P::manifest_head(&manifest).count, self.limit());
        (self.observe)(ProductEvent::Manifest(&manifest));
        let place = self.place(&key);
        let entry = &mut self.entries[place];
        let hash = P::announced_hash(&manifest).to_owned();
        let other = entry.assembly.manifest().is_some_and(|old| P::announced_hash(old) != hash);
        if let Err(e) = entry.assembly.add_manifest(manifest) {
            self.node.warn(format!("a manifest on {} was dropped: {e}", P::MANIFEST_TOPIC));
            return;
        }
        // What was announced for another run is history; chunks without a manifest may be this run's.
        self.entries.retain(|e| e.assembly.manifest().is_none() || same_run(e.assembly.key(), &key));
        let place = self.place(&key);
        let entry = &mut self.entries[place];
        if other || std::mem::take(&mut entry.failed) {
            entry.settled = false;
            entry.invalid = 0;
        }
        entry.touch();
        if i64::from(count) > limit {
            let text = format!("it has {count} chunks: at most {limit} ({LIMIT}) are taken");
            self.settle(place, Err(text));
        } else {
            self.deliver(place);
            self.observe_pending();
        }
    }

    fn observe_pending(&mut self) {
        let pending = self.entries.iter().filter(|e| e.is_announced()).count();
        (self.observe)(ProductEvent::Pending(pending));
    }

    fn take_chunk(&mut self, chunk: P::Chunk) {
        let key = P::chunk_key(&chunk);
        let announced = |e: &Entry<P>| e.assembly.manifest().is_some() && *e.assembly.key() == key;
        if !self.entries.iter().any(announced) && !self.has_room_for(&chunk) {
            // Whoever looks on sees it all the same, though perhaps again when it is asked for.
            (self.observe)(ProductEvent::Chunk(&chunk));
            return;
        }
        let place = self.place(&key);
        if self.add_chunk(place, chunk) {
            self.entries[place].touch();
            self.deliver(place);
        }
    }

    /// Whether a chunk may be kept that no manifest has announced. Of what is too large its manifest will tell; what finds no room is asked
    /// for when its manifest comes.
    fn has_room_for(&self, chunk: &P::Chunk) -> bool {
        let limit = self.limit();
        let orphans = self.entries.iter().filter(|e| e.assembly.manifest().is_none());
        let held: usize = orphans.map(|e| e.assembly.held()).sum();
        i64::from(P::chunk_head(chunk).count) <= limit && (held as i64) < limit
    }

    /// Whether it is a chunk that was missing.
    fn add_chunk(&mut self, place: usize, chunk: P::Chunk) -> bool {
        let entry = &mut self.entries[place];
        let index = P::chunk_index(&chunk);
        if entry.settled || entry.assembly.has(index) {
            return false;
        }
        let copy = chunk.clone();
        match entry.assembly.add_chunk(chunk) {
            Ok(()) => {
                (self.observe)(ProductEvent::Chunk(&copy));
                true
            }
            Err(e) => {
                self.node.warn(format!("a chunk on {} was dropped: {e}", P::CHUNK_TOPIC));
                false
            }
        }
    }

    fn take_round(&mut self, round: Round<P>) {
        let Some(place) = self.entries.iter().position(|e| *e.assembly.key() == round.key) else { return };
        let mut fruitful = false;
        for chunk in round.chunks {
            if P::chunk_key(&chunk) == round.key {
                fruitful |= self.add_chunk(place, chunk);
            }
        }
        let entry = &mut self.entries[place];
        entry.asking = false;
        entry.fruitless = if fruitful { 0 } else { entry.fruitless + 1 };
        // After a fruitful round the next one follows at once.
        entry.due = if fruitful { Instant::now() } else { Instant::now() + QUIET * (1 + entry.fruitless) };
        if entry.fruitless >= ROUNDS && !entry.settled {
            let missing = entry.assembly.missing().len();
            let count = entry.assembly.progress().map_or(0, |(_, count)| count);
            let why = round.failure.unwrap_or_else(|| "no answer fits".to_owned());
            let text = format!("{missing} of {count} chunks of the {} did not come: {why}", P::WHAT);
            self.settle(place, Err(text));
        } else {
            self.deliver(place);
        }
    }

    fn deliver(&mut self, place: usize) {
        let entry = &mut self.entries[place];
        match entry.assembly.complete() {
            None => {}
            Some(Ok(product)) => self.settle(place, Ok(product)),
            // Chunks of two versions may have met: all are missing again, the service gives those of one version.
            Some(Err(_)) if entry.invalid < INVALID => {
                entry.invalid += 1;
                entry.due = Instant::now() + QUIET;
            }
            Some(Err(e)) => self.settle(place, Err(e.text)),
        }
    }

    fn settle(&mut self, place: usize, result: Result<P, String>) {
        let entry = &mut self.entries[place];
        entry.settled = true;
        entry.failed = result.is_err();
        entry.assembly.clear();
        let key = entry.assembly.key().clone();
        let received = match (result, entry.assembly.manifest()) {
            (Ok(product), Some(manifest)) => {
                Received::Product { key, manifest: Box::new(manifest.clone()), product }
            }
            (Ok(_), None) => return,
            (Err(text), _) => Received::Failed { key, text },
        };
        self.observe_pending();
        // The receiver may have been dropped; the task is aborted then.
        let _ = self.sender.send(received);
    }

    fn ask(&mut self) {
        let now = Instant::now();
        for entry in self.entries.iter_mut().filter(|e| e.is_waiting() && e.due <= now) {
            entry.asking = true;
            let (key, mut missing) = (entry.assembly.key().clone(), entry.assembly.missing());
            missing.truncate(BATCH);
            let (client, answers) = (Arc::clone(&self.client), self.answers.clone());
            self.node.spawn(async move {
                let round = fetch::<P>(&client, key, missing).await;
                let _ = answers.send(round);
            });
        }
    }

    /// Place of the entry with that key, a new one if there is none.
    fn place(&mut self, key: &ProductKey) -> usize {
        if let Some(place) = self.entries.iter().position(|e| e.assembly.key() == key) {
            return place;
        }
        let orphans = self.entries.iter().filter(|e| e.assembly.manifest().is_none()).count();
        if orphans >= ORPHANS
            && let Some(oldest) = self.entries.iter().position(|e| e.assembly.manifest().is_none())
        {
            self.entries.remove(oldest);
        }
        self.entries.push(Entry {
            assembly: Assembly::new(key.clone()),
            due: Instant::now() + QUIET,
            asking: false,
            fruitless: 0,
            invalid: 0,
            settled: false,
            failed: false,
        });
        self.entries.len() - 1
    }
}

impl<P: LargeProduct> Entry<P> {
    fn is_announced(&self) -> bool {
        self.assembly.manifest().is_some() && !self.settled
    }

    fn is_waiting(&self) -> bool {
        self.is_announced() && !self.asking
    }

    fn touch(&mut self) {
        self.due = Instant::now() + QUIET;
        self.fruitless = 0;
    }
}

fn same_run(a: &ProductKey, b: &ProductKey) -> bool {
    (&a.surface_id, &a.job_id, a.stamp) == (&b.surface_id, &b.job_id, b.stamp)
}

async fn fetch<P: LargeProduct>(
    client: &ServiceClient<P::GetChunk>,
    key: ProductKey,
    missing: Vec<u32>,
) -> Round<P> {
    let mut round = Round { key, chunks: Vec::with_capacity(missing.len()), failure: None };
    for index in missing {
        let answer = client.call(&P::request(&round.key, index), ATTEMPT, DEADLINE).await;
        match answer.map_err(|e| e.to_string()).and_then(P::answered) {
            Ok(chunk) => round.chunks.push(chunk),
            Err(text) => {
                round.failure = Some(text);
                break;
            }
        }
    }
    round
}

#[cfg(test)]
mod tests {
    use patchmill_geometry::mesh::TriangleMesh;
    use patchmill_msgs::msg::MeshChunk;

    use super::*;
    use crate::arguments::{NodeOptions, Override};
    use crate::{Value, block_on, free_domain};

    #[test]
    fn chunks_that_nothing_announces_are_held_in_bounded_numbers() {
        const MOST: i64 = 20;
        let lease = free_domain().unwrap();
        let mut options =
            NodeOptions::local("receiver", lease.domain()).with_parameters(ParameterSet::new().max_chunks());
        let value = Value::Integer(MOST);
        options.arguments.overrides.push(Override {
            node: None,
            name: LIMIT.to_owned(),
            value,
            strict: true,
        });
        block_on(async {
            let node = Node::start(options).unwrap();
            let (sender, _receiver) = mpsc::unbounded_channel();
            let mut task = Task::<TriangleMesh>::new(&node, sender, Box::new(|_| {})).unwrap();
            let stray = |surface: usize, index: u32, count: u32| MeshChunk {
                surface_id: surface.to_string(),
                index,
                count,
                ..MeshChunk::default()
            };
            let held = |task: &Task<TriangleMesh>| -> Vec<usize> {
                task.entries.iter().map(|e| e.assembly.held()).collect()
            };
            // One each of many products: the newest products stay.
            for surface in 0..10 * ORPHANS {
                task.take_chunk(stray(surface, 0, 2));
            }
            assert_eq!(held(&task), [1; ORPHANS]);
            // Many of one product: as many as a product may have.
            for index in 0..10 * MOST as u32 {
                task.take_chunk(stray(10 * ORPHANS - 1, index, MOST as u32));
            }
            assert_eq!(held(&task).iter().sum::<usize>(), MOST as usize);
            // Of a product that would be refused none.
            task.entries.clear();
            task.take_chunk(stray(0, 0, MOST as u32 + 1));
            assert_eq!(held(&task), []);
            node.shutdown().await;
        })
        .unwrap();
    }
}
