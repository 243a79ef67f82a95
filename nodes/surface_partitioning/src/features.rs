//! The feature space of the partition: z-scored [x, y, z, κ*].

use nalgebra::Vector4;
use patchmill_products::field::RollingBallField;
use patchmill_products::partition::feature;
use patchmill_products::samples::SurfaceSamples;

/// Variations below this length make no patches: a tenth of a micrometre, well under any scallop height.
const LENGTH_FLOOR: f64 = 1e-7;

/// The features of all samples with the origin and scale of their z-score.
#[derive(Clone, Debug)]
pub struct Features {
    /// [x, y, z, κ*] (m, m, m, 1/m) of every sample.
    pub raw: Vec<Vector4<f64>>,
    /// The same, z-scored: (raw − mean) / scale.
    pub scored: Vec<Vector4<f64>>,
    /// Mean of `raw`.
    pub mean: Vector4<f64>,
    /// Standard deviation of `raw`; 1 for a feature that does not vary.
    pub scale: Vector4<f64>,
}

impl Features {
    /// Features of samples and their field, which have to be of the same length and not empty.
    ///
    /// A coordinate that varies by less than 0.1 µm, or a curvature whose sagitta over the shadow does, counts
    /// as constant: its scale is 1, which leaves nothing of it in the z-scores. Otherwise rounding noise would be
    /// blown up to the weight of a real feature.
    pub fn new(samples: &SurfaceSamples, field: &RollingBallField) -> Self {
        let raw: Vec<_> =
            samples.points.iter().zip(&field.pseudo_curvature).map(|(p, &k)| feature(p, k)).collect();
        let n = raw.len() as f64;
        let mean = raw.iter().sum::<Vector4<f64>>() / n;
        let variance = raw.iter().map(|x| (x - mean).component_mul(&(x - mean))).sum::<Vector4<f64>>() / n;
        let shadow = field.shadow_radius.max(1e-3);
        let curvature_floor = 2.0 * LENGTH_FLOOR / (shadow * shadow);
        let floor = Vector4::new(LENGTH_FLOOR, LENGTH_FLOOR, LENGTH_FLOOR, curvature_floor);
        let deviation = variance.map(f64::sqrt);
        let scale = deviation.zip_map(&floor, |s, floor| if s > floor { s } else { 1.0 });
        let scored = raw.iter().map(|x| (x - mean).component_div(&scale)).collect();
        Self { raw, scored, mean, scale }
    }

    /// Number of different feature vectors.
    pub fn distinct(&self) -> usize {
        let mut keys: Vec<[u64; 4]> =
            self.scored.iter().map(|x| [x[0], x[1], x[2], x[3]].map(|v| (v + 0.0).to_bits())).collect();
        keys.sort_unstable();
        keys.dedup();
        keys.len()
    }
}
