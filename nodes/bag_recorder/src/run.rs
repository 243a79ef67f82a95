//! A recorded run as products again.

use std::path::{Path, PathBuf};

use patchmill_msgs::{RosType, msg};
use patchmill_node_runtime::{JobTag, LargeProduct, ProductKey, topics};
use patchmill_products::job::Job;
use patchmill_products::partition::Partition;
use patchmill_products::wire::Assembly;

use crate::{BagError, BagMessage, BagReader};

/// Namespace under which the topics were recorded.
const NAMESPACE: &str = "/patchmill";

/// A bag in memory, as jobs and products.
pub struct RecordedRun {
    messages: Vec<BagMessage>,
    unfinished: Vec<PathBuf>,
}

fn error(text: impl Into<String>) -> BagError {
    BagError { text: text.into() }
}

impl RecordedRun {
    /// Reads a bag.
    ///
    /// # Errors
    /// As [`BagReader::messages`].
    pub fn open(folder: &Path) -> Result<Self, BagError> {
        let (messages, unfinished) = BagReader::open(folder)?.read(|_| true)?;
        Ok(Self { messages, unfinished })
    }

    /// Files without an end: their recorder was killed, what came last is missing.
    pub fn unfinished(&self) -> &[PathBuf] {
        &self.unfinished
    }

    /// All messages of a topic (relative to `/patchmill`, or absolute) in the order in which they came.
    ///
    /// # Errors
    /// When one does not decode.
    pub fn messages<T: RosType>(&self, topic: &str) -> Result<Vec<T>, BagError> {
        let name = if topic.starts_with('/') { topic.to_owned() } else { format!("{NAMESPACE}/{topic}") };
        self.messages.iter().filter(|m| m.topic == name).map(BagMessage::decode).collect()
    }

    /// The messages of all jobs, each run of a job once, in the order in which they came; withdrawals are left out.
    ///
    /// # Errors
    /// When one does not decode.
    pub fn jobs(&self) -> Result<Vec<msg::Job>, BagError> {
        let mut jobs: Vec<msg::Job> = Vec::new();
        for job in self.messages::<msg::Job>(topics::JOB)? {
            let same = |known: &msg::Job| JobTag::of_job(known) == JobTag::of_job(&job);
            if !job.job_id.is_empty() && !jobs.iter().any(same) {
                jobs.push(job);
            }
        }
        Ok(jobs)
    }

    /// The job of a bag with one run.
    ///
    /// # Errors
    /// When there is not exactly one valid job.
    pub fn job(&self) -> Result<Job, BagError> {
        match self.jobs()?.as_slice() {
            [job] => Job::from_msg(job).map_err(|e| error(e.text)),
            jobs => Err(error(format!("{} jobs in the bag, one was expected", jobs.len()))),
        }
    }

    /// The candidate partitions by index; of one run of a job, or of all.
    ///
    /// # Errors
    /// When one is not valid.
    pub fn partitions_of(&self, run: Option<&JobTag>) -> Result<Vec<Partition>, BagError> {
        let mut partitions: Vec<Partition> = Vec::new();
        for message in self.messages::<msg::PartitionCandidate>(topics::PARTITION_CANDIDATES)? {
            let (provenance, partition) = Partition::from_msg(&message).map_err(|e| error(e.text))?;
            if run.is_none_or(|run| *run == JobTag::of_provenance(&provenance)) {
                partitions.retain(|known| known.index != partition.index);
                partitions.push(partition);
            }
        }
        partitions.sort_by_key(|p| p.index);
        Ok(partitions)
    }

    /// The candidate partitions of a bag with one run, by index.
    ///
    /// # Errors
    /// When one is not valid.
    pub fn partitions(&self) -> Result<Vec<Partition>, BagError> {
        self.partitions_of(None)
    }

    /// Every large product of a kind that is wanted, the newest of each key, with what announced it. Of a bag without an
    /// end only those that are whole.
    ///
    /// # Errors
    /// When one is not whole or not valid.
    pub fn products_of<P: LargeProduct>(
        &self,
        wanted: impl Fn(&ProductKey) -> bool,
    ) -> Result<Vec<(P::Manifest, P)>, BagError> {
        let mut manifests: Vec<(ProductKey, P::Manifest)> = Vec::new();
        for manifest in self.messages::<P::Manifest>(P::MANIFEST_TOPIC)? {
            let key = P::manifest_key(&manifest);
            manifests.retain(|(known, _)| *known != key);
            manifests.push((key, manifest));
        }
        manifests.retain(|(key, _)| wanted(key));
        if manifests.is_empty() {
            return Ok(Vec::new());
        }
        let chunks = self.messages::<P::Chunk>(P::CHUNK_TOPIC)?;
        let mut whole = Vec::new();
        for (key, manifest) in manifests {
            match assemble::<P>(&key, &manifest, &chunks)? {
                Ok(product) => whole.push((manifest, product)),
                Err(_) if !self.unfinished.is_empty() => {}
                Err(incomplete) => return Err(incomplete),
            }
        }
        Ok(whole)
    }

    /// Every large product of a kind.
    ///
    /// # Errors
    /// When one is not whole or not valid.
    pub fn products<P: LargeProduct>(&self) -> Result<Vec<P>, BagError> {
        let all = self.products_of::<P>(|_| true)?;
        Ok(all.into_iter().map(|(_, product)| product).collect())
    }

    /// The only product of a kind.
    ///
    /// # Errors
    /// When there is not exactly one.
    pub fn product<P: LargeProduct>(&self) -> Result<P, BagError> {
        let mut all = self.products()?;
        match (all.pop(), all.len()) {
            (Some(product), 0) => Ok(product),
            (_, more) => Err(error(format!("{more} more or no {} in the bag, one was expected", P::WHAT))),
        }
    }
}

/// The product, or inside, that chunks of it are missing.
fn assemble<P: LargeProduct>(
    key: &ProductKey,
    manifest: &P::Manifest,
    chunks: &[P::Chunk],
) -> Result<Result<P, BagError>, BagError> {
    let mut assembly = Assembly::<P>::new(key.clone());
    assembly.add_manifest(manifest.clone()).map_err(|e| error(e.text))?;
    for chunk in chunks.iter().filter(|chunk| P::chunk_key(chunk) == *key) {
        // A chunk of an older version of the product has another count; the hash tells the rest.
        let _ = assembly.add_chunk(chunk.clone());
    }
    match assembly.complete() {
        Some(product) => product.map(Ok).map_err(|e| error(format!("the bag: {}", e.text))),
        None => {
            let missing = assembly.missing();
            Ok(Err(error(format!("the bag: chunks {missing:?} of the {} are missing", P::WHAT))))
        }
    }
}
