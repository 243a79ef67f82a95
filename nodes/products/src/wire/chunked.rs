//! Large products: a manifest that announces, numbered chunks that carry, an assembly that puts together.

use std::collections::BTreeMap;

use patchmill_msgs::RosType;
use patchmill_msgs::std_msgs::msg::Header;

use super::check::expect;
use super::provenance::check_id;
use super::{Provenance, WireError};

/// No chunk's CDR is longer, bytes. One UDP datagram on the loopback holds it: rustdds 0.15.1 sends a service's answer that must
/// be fragmented with a byte too many, so that nobody can read it.
pub const MAX_CHUNK_BYTES: usize = 60 * 1024;

/// Bytes of data that are put into one chunk; the rest up to [`MAX_CHUNK_BYTES`] is for header, ids and padding.
pub(super) const CHUNK_DATA: usize = 54 * 1024;

/// Most chunks of a product, 3.6 GB.
pub const MAX_CHUNKS: u32 = 65_536;

/// Most candidates of a job.
const MAX_CANDIDATES: u32 = 64;

/// What a manifest or a chunk says of itself.
pub struct Head<'a> {
    /// Its header.
    pub header: &'a Header,
    /// Its surface.
    pub surface_id: &'a str,
    /// Its job; empty for what depends on the surface alone.
    pub job_id: &'a str,
    /// Its candidate; 0 where there is none.
    pub candidate: u32,
    /// Number of chunks of the product.
    pub count: u32,
}

/// Tells products of one kind apart. What depends on the surface alone is known by its surface, the rest by the run of
/// the job (id and stamp) and the candidate.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Key {
    /// Content hash of the surface.
    pub surface_id: String,
    /// Content hash of the job, or empty.
    pub job_id: String,
    /// Seconds and nanoseconds of the job's stamp; zero without a job.
    pub stamp: (i32, u32),
    /// Place among the job's candidates; 0 where there are none.
    pub candidate: u32,
}

impl Head<'_> {
    fn key(&self) -> Key {
        let stamp = &self.header.stamp;
        Key {
            surface_id: self.surface_id.to_owned(),
            job_id: self.job_id.to_owned(),
            stamp: if self.job_id.is_empty() { (0, 0) } else { (stamp.sec, stamp.nanosec) },
            candidate: self.candidate,
        }
    }

    fn check(&self, what: &str) -> Result<(), WireError> {
        check_id("surface_id", self.surface_id)?;
        check_id("job_id", self.job_id)?;
        let within = format!("less than {MAX_CANDIDATES}");
        expect(self.candidate < MAX_CANDIDATES, "the candidate's place", self.candidate, &within)?;
        let expected = format!("at most {MAX_CHUNKS}");
        expect(self.count <= MAX_CHUNKS, &format!("the number of chunks of a {what}"), self.count, &expected)
    }
}

/// Heads, hash and number of the manifests and chunks of a product of a job, in an `impl Chunked`.
macro_rules! heads_of_job {
    () => {
        fn manifest_head(manifest: &Self::Manifest) -> $crate::wire::chunked::Head<'_> {
            $crate::wire::chunked::Head {
                header: &manifest.header,
                surface_id: &manifest.surface_id,
                job_id: &manifest.job_id,
                candidate: 0,
                count: manifest.chunk_count,
            }
        }

        fn announced_hash(manifest: &Self::Manifest) -> &str {
            &manifest.content_hash
        }

        fn chunk_head(chunk: &Self::Chunk) -> $crate::wire::chunked::Head<'_> {
            $crate::wire::chunked::Head {
                header: &chunk.header,
                surface_id: &chunk.surface_id,
                job_id: &chunk.job_id,
                candidate: 0,
                count: chunk.count,
            }
        }

        fn chunk_index(chunk: &Self::Chunk) -> u32 {
            chunk.index
        }
    };
}
pub(super) use heads_of_job;

/// A product that travels in chunks.
pub trait Chunked: Sized {
    /// What it is called in texts.
    const WHAT: &'static str;
    /// Announces it.
    type Manifest: RosType;
    /// A numbered piece.
    type Chunk: RosType;

    /// Manifest and chunks in order, each at most [`MAX_CHUNK_BYTES`] of CDR.
    ///
    /// # Errors
    /// When the product is not valid, as [`Chunked::check`] says.
    fn split(&self, provenance: &Provenance) -> Result<(Self::Manifest, Vec<Self::Chunk>), WireError>;

    /// The product from its manifest and all its chunks in order. Counts are checked before anything is allocated;
    /// what the product holds is left to [`Chunked::check`] and the hash to the caller: use [`Assembly`].
    ///
    /// # Errors
    /// When counts, places or lengths do not fit each other.
    fn join(manifest: &Self::Manifest, chunks: Vec<Self::Chunk>) -> Result<Self, WireError>;

    /// Whether everything in the product is as its documentation says.
    ///
    /// # Errors
    /// With the first thing that is not.
    fn check(&self) -> Result<(), WireError>;

    /// sha256 (hex) over all data of the product, numbers as little-endian.
    fn content_hash(&self) -> String;

    /// What a manifest says of itself.
    fn manifest_head(manifest: &Self::Manifest) -> Head<'_>;

    /// The hash that a manifest announces.
    fn announced_hash(manifest: &Self::Manifest) -> &str;

    /// What a chunk says of itself.
    fn chunk_head(chunk: &Self::Chunk) -> Head<'_>;

    /// A chunk's number, 0-based.
    fn chunk_index(chunk: &Self::Chunk) -> u32;

    /// Which product a manifest announces.
    fn manifest_key(manifest: &Self::Manifest) -> Key {
        Self::manifest_head(manifest).key()
    }

    /// Which product a chunk belongs to.
    fn chunk_key(chunk: &Self::Chunk) -> Key {
        Self::chunk_head(chunk).key()
    }
}

/// Puts one product together from its manifest and chunks, whatever order they come in.
pub struct Assembly<P: Chunked> {
    key: Key,
    manifest: Option<P::Manifest>,
    chunks: BTreeMap<u32, P::Chunk>,
    delivered: bool,
}

impl<P: Chunked> Assembly<P> {
    /// Of the product with that key.
    pub fn new(key: Key) -> Self {
        Self { key, manifest: None, chunks: BTreeMap::new(), delivered: false }
    }

    /// Which product this is.
    pub fn key(&self) -> &Key {
        &self.key
    }

    /// The manifest once it has come.
    pub fn manifest(&self) -> Option<&P::Manifest> {
        self.manifest.as_ref()
    }

    /// Takes the manifest. The same again changes nothing; one with another hash starts anew.
    ///
    /// # Errors
    /// When it announces another product or is not valid; the assembly stays as it was.
    pub fn add_manifest(&mut self, manifest: P::Manifest) -> Result<(), WireError> {
        let head = P::manifest_head(&manifest);
        Provenance::read(head.header, head.surface_id, head.job_id)?;
        self.check_head(&head)?;
        if let Some(old) = &self.manifest {
            if P::announced_hash(old) == P::announced_hash(&manifest) {
                return Ok(());
            }
            self.chunks.clear();
            self.delivered = false;
        }
        let count = head.count;
        self.chunks.retain(|_, chunk| P::chunk_head(chunk).count == count);
        self.manifest = Some(manifest);
        Ok(())
    }

    /// Takes a chunk, before or after the manifest; one that is there already is ignored.
    ///
    /// # Errors
    /// When it belongs to another product, or its number or count does not fit; the assembly stays as it was.
    pub fn add_chunk(&mut self, chunk: P::Chunk) -> Result<(), WireError> {
        let (head, index) = (P::chunk_head(&chunk), P::chunk_index(&chunk));
        self.check_head(&head)?;
        expect(index < head.count, "a chunk's number", index, &format!("less than {}", head.count))?;
        if let Some(manifest) = &self.manifest {
            let count = P::manifest_head(manifest).count;
            expect(
                head.count == count,
                "a chunk's count",
                head.count,
                &format!("{count} as in the manifest"),
            )?;
        }
        if !self.delivered {
            self.chunks.entry(index).or_insert(chunk);
        }
        Ok(())
    }

    /// Whether a chunk is there.
    pub fn has(&self, index: u32) -> bool {
        self.chunks.contains_key(&index)
    }

    /// Number of chunks that are there.
    pub fn held(&self) -> usize {
        self.chunks.len()
    }

    /// Lets go of the chunks that are there.
    pub fn clear(&mut self) {
        self.chunks.clear();
    }

    /// Numbers of the chunks that have not come; none while the manifest is missing or after delivery.
    pub fn missing(&self) -> Vec<u32> {
        match &self.manifest {
            Some(manifest) if !self.delivered => (0..P::manifest_head(manifest).count)
                .filter(|index| !self.chunks.contains_key(index))
                .collect(),
            _ => Vec::new(),
        }
    }

    /// Number of chunks that are there and number of chunks in all; `None` while the manifest is missing.
    pub fn progress(&self) -> Option<(u32, u32)> {
        let count = P::manifest_head(self.manifest.as_ref()?).count;
        Some((if self.delivered { count } else { self.chunks.len() as u32 }, count))
    }

    /// The product, once, as soon as everything is there; then the chunks are let go.
    ///
    /// `Some(Err)` when what came is not what the manifest announced or is not valid. Then all chunks are missing again.
    pub fn complete(&mut self) -> Option<Result<P, WireError>> {
        let manifest = self.manifest.as_ref()?;
        if self.delivered || self.chunks.len() != P::manifest_head(manifest).count as usize {
            return None;
        }
        let chunks = std::mem::take(&mut self.chunks).into_values().collect();
        let product = Self::assemble(manifest, chunks).map_err(|e| {
            WireError::new(format!("{} of surface '{}': {}", P::WHAT, self.key.surface_id, e.text))
        });
        self.delivered = product.is_ok();
        Some(product)
    }

    fn assemble(manifest: &P::Manifest, chunks: Vec<P::Chunk>) -> Result<P, WireError> {
        let product = P::join(manifest, chunks)?;
        product.check()?;
        let (hash, announced) = (product.content_hash(), P::announced_hash(manifest));
        expect(
            hash == announced,
            "the hash of what came",
            &hash,
            &format!("'{announced}' as in the manifest"),
        )?;
        Ok(product)
    }

    fn check_head(&self, head: &Head<'_>) -> Result<(), WireError> {
        head.check(P::WHAT)?;
        if head.key() == self.key {
            return Ok(());
        }
        Err(WireError::new(format!("a {} of {:?} came, {:?} was expected", P::WHAT, head.key(), self.key)))
    }
}
