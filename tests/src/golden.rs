//! The golden bag: one small run, recorded by `launch_scripts/refresh_golden.sh`, as products again.

use std::path::{Path, PathBuf};

use patchmill_bag_recorder::BagReader;
use patchmill_msgs::msg;
use patchmill_node_runtime::LargeProduct;
use patchmill_products::job::Job;
use patchmill_products::partition::Partition;
use patchmill_products::wire::Assembly;

/// Folder of the golden bag.
pub fn golden_bag() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("golden/small_bezier")
}

/// A bag as products.
pub struct RecordedRun {
    bag: BagReader,
}

impl RecordedRun {
    /// Opens a bag.
    ///
    /// # Errors
    /// When it is none.
    pub fn open(folder: &Path) -> Result<Self, String> {
        Ok(Self { bag: BagReader::open(folder).map_err(|e| e.text)? })
    }

    /// All messages of a topic under `/patchmill`.
    ///
    /// # Errors
    /// When one does not decode.
    pub fn messages<T: patchmill_msgs::RosType>(&self, topic: &str) -> Result<Vec<T>, String> {
        self.bag.decoded(&format!("/patchmill/{topic}")).map_err(|e| e.text)
    }

    /// The job.
    ///
    /// # Errors
    /// When there is not exactly one valid job.
    pub fn job(&self) -> Result<Job, String> {
        match self.messages::<msg::Job>("job")?.as_slice() {
            [job] => Job::from_msg(job).map_err(|e| e.text),
            jobs => Err(format!("{} jobs in the bag, one was expected", jobs.len())),
        }
    }

    /// The candidate partitions by index.
    ///
    /// # Errors
    /// When one is not valid.
    pub fn partitions(&self) -> Result<Vec<Partition>, String> {
        let messages = self.messages::<msg::PartitionCandidate>("partition/candidates")?;
        let mut partitions: Vec<Partition> = messages
            .iter()
            .map(|m| Partition::from_msg(m).map(|(_, p)| p).map_err(|e| e.text))
            .collect::<Result<_, _>>()?;
        partitions.sort_by_key(|p| p.index);
        Ok(partitions)
    }

    /// Every large product of a kind, assembled from its manifests and chunks.
    ///
    /// # Errors
    /// When one is not whole or not valid.
    pub fn products<P: LargeProduct>(&self) -> Result<Vec<P>, String> {
        let manifests = self.messages::<P::Manifest>(P::MANIFEST_TOPIC)?;
        let chunks = self.messages::<P::Chunk>(P::CHUNK_TOPIC)?;
        manifests
            .into_iter()
            .map(|manifest| {
                let key = P::manifest_key(&manifest);
                let mut assembly = Assembly::<P>::new(key.clone());
                assembly.add_manifest(manifest).map_err(|e| e.text)?;
                for chunk in chunks.iter().filter(|chunk| P::chunk_key(chunk) == key) {
                    assembly.add_chunk(chunk.clone()).map_err(|e| e.text)?;
                }
                match assembly.complete() {
                    Some(product) => product.map_err(|e| e.text),
                    None => Err(format!("{}: chunks {:?} are missing", P::WHAT, assembly.missing())),
                }
            })
            .collect()
    }

    /// The only product of a kind.
    ///
    /// # Errors
    /// When there is not exactly one.
    pub fn product<P: LargeProduct>(&self) -> Result<P, String> {
        let mut all = self.products()?;
        match (all.pop(), all.len()) {
            (Some(product), 0) => Ok(product),
            (_, more) => Err(format!("{more} more or no {} in the bag, one was expected", P::WHAT)),
        }
    }
}
