//! Content hashes: sha256 over the little-endian data.

use nalgebra::{Point3, Vector3};
use sha2::{Digest, Sha256};

/// Takes the data of a product, gives its hash as hex digits. Lengths are hashed with arrays and texts, so that data
/// cannot move from one to the next unseen.
#[derive(Default)]
pub(super) struct ContentHash(Sha256);

impl ContentHash {
    pub(super) fn number(&mut self, value: f64) {
        self.0.update(value.to_le_bytes());
    }

    pub(super) fn integer(&mut self, value: u32) {
        self.0.update(value.to_le_bytes());
    }

    pub(super) fn length(&mut self, value: usize) {
        self.0.update((value as u64).to_le_bytes());
    }

    pub(super) fn text(&mut self, text: &str) {
        self.length(text.len());
        self.0.update(text.as_bytes());
    }

    pub(super) fn bytes(&mut self, bytes: &[u8]) {
        self.0.update(bytes);
    }

    pub(super) fn numbers(&mut self, values: &[f64]) {
        self.length(values.len());
        values.iter().for_each(|v| self.number(*v));
    }

    pub(super) fn points(&mut self, points: &[Point3<f64>]) {
        self.length(points.len());
        points.iter().flat_map(|p| p.iter()).for_each(|c| self.number(*c));
    }

    pub(super) fn vectors(&mut self, vectors: &[Vector3<f64>]) {
        self.length(vectors.len());
        vectors.iter().flat_map(|v| v.iter()).for_each(|c| self.number(*c));
    }

    /// 64 hex digits.
    pub(super) fn hex(self) -> String {
        self.0.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
    }
}
