//! The sender of a large product: publishes manifest and chunks, keeps them for those who miss some.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use patchmill_products::wire::{Provenance, WireError};

use crate::RuntimeError;
use crate::chunks::ChunkPublisher;
use crate::node::{Node, Publisher};
use crate::products::{LargeProduct, ProductKey};
use crate::qos::Qos;

/// Publishes a kind of large product and answers for single chunks of the newest run (all its candidates).
pub struct ProductServer<P: LargeProduct> {
    manifests: Publisher<P::Manifest>,
    chunks: ChunkPublisher<P::Chunk>,
    kept: Arc<Mutex<Vec<Kept<P>>>>,
}

struct Kept<P: LargeProduct> {
    key: ProductKey,
    chunks: Arc<Vec<P::Chunk>>,
}

impl<P: LargeProduct> ProductServer<P> {
    /// Offers the topics and the service.
    ///
    /// # Errors
    /// As [`Node::publisher`] and [`Node::serve`].
    pub fn new(node: &Node) -> Result<Self, RuntimeError> {
        let kept: Arc<Mutex<Vec<Kept<P>>>> = Arc::new(Mutex::new(Vec::new()));
        let chunks = ChunkPublisher::new(node, P::CHUNK_TOPIC)?;
        let asked = Arc::clone(&kept);
        node.serve::<P::GetChunk, _, _>(P::SERVICE_NAME, move |request| {
            let (id, candidate, index) = P::wanted(&request);
            std::future::ready(P::answer(find::<P>(&asked, id, candidate, index)))
        })?;
        Ok(Self { manifests: node.publisher(P::MANIFEST_TOPIC, Qos::Product)?, chunks, kept })
    }

    /// Publishes a product. Returns when its chunks are on their way (at 28 MB/s at most), with how many were sent;
    /// when readers stop acknowledging, the rest is left to the service.
    ///
    /// # Errors
    /// When the product is not valid.
    pub async fn publish(&self, product: &P, provenance: &Provenance) -> Result<usize, WireError> {
        let (manifest, chunks) = product.split(provenance)?;
        Ok(self.publish_parts(manifest, chunks).await)
    }

    /// [`ProductServer::publish`] of a product that is already split, for callers that split in a blocking thread.
    pub async fn publish_parts(&self, manifest: P::Manifest, chunks: Vec<P::Chunk>) -> usize {
        let chunks = Arc::new(chunks);
        self.keep(P::manifest_key(&manifest), Arc::clone(&chunks));
        // A manifest that cannot be published leaves nothing to do: the window of 8192 is never full of manifests.
        let _ = self.manifests.publish(manifest);
        self.chunks.publish_paced(chunks.iter().cloned()).await
    }

    /// Waits until so many receivers are matched to the chunks; `false` when the time is over first.
    pub async fn wait_for_receivers(&self, count: usize, patience: Duration) -> bool {
        self.manifests.wait_for_subscriptions(count, patience).await
            && self.chunks.publisher().wait_for_subscriptions(count, patience).await
    }

    fn keep(&self, key: ProductKey, chunks: Arc<Vec<P::Chunk>>) {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        kept.retain(|k| same_run(&k.key, &key) && k.key.candidate != key.candidate);
        kept.push(Kept { key, chunks });
    }
}

fn same_run(a: &ProductKey, b: &ProductKey) -> bool {
    (&a.surface_id, &a.job_id, a.stamp) == (&b.surface_id, &b.job_id, b.stamp)
}

fn find<P: LargeProduct>(
    kept: &Mutex<Vec<Kept<P>>>,
    id: &str,
    candidate: u32,
    index: u32,
) -> Result<P::Chunk, String> {
    let chunks = {
        let kept = kept.lock().unwrap_or_else(PoisonError::into_inner);
        let product = kept.iter().find(|k| P::id(&k.key) == id && k.key.candidate == candidate);
        product.map(|k| Arc::clone(&k.chunks))
    };
    let chunks = chunks.ok_or_else(|| format!("there is no {} of '{id}' here", P::WHAT))?;
    let count = chunks.len();
    chunks
        .get(index as usize)
        .cloned()
        .ok_or_else(|| format!("chunk {index} of the {} was asked for: it has {count}", P::WHAT))
}
