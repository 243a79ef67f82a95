//! A candidate partition of the samples into patches.

use nalgebra::{Matrix4, Point3, Vector4};

/// One partition.
#[derive(Clone, Debug, PartialEq)]
pub struct Partition {
    /// Place among the job's candidates, 0-based.
    pub index: u32,
    /// Number of candidates of the job.
    pub count: u32,
    /// Mean of [x, y, z, κ*] (m, m, m, 1/m) over all samples: the z-score's origin.
    pub feature_mean: Vector4<f64>,
    /// Standard deviation of the same, never 0: the z-score's scale.
    pub feature_scale: Vector4<f64>,
    /// Patch of every sample: what [`Classifier::classify`] says of its features with the `patches` below.
    pub labels: Vec<u8>,
    /// The patches, as many as this candidate asks for.
    pub patches: Vec<PatchStatistics>,
    /// Sum of squared z-scored distances of the plain k-means solution (which is not what `labels` come from where the least time
    /// is asked for).
    pub inertia: f64,
}

/// What classifies a point to a patch: z-scored mean and covariance of its samples.
#[derive(Clone, Debug, PartialEq)]
pub struct PatchStatistics {
    /// Mean of the z-scored features that classification uses.
    pub mean: Vector4<f64>,
    /// Covariance of the z-scored features that classification uses, with 1e-3 added to its diagonal; the
    /// identity in all patches of a candidate whose patches would not survive classification by covariance.
    pub covariance: Matrix4<f64>,
    /// Samples of the patch by `Partition::labels`.
    pub sample_count: u32,
    /// Connected parts of the patch, in samples, largest first.
    pub parts: Vec<u32>,
}

/// The features that patches are made of: [x, y, z, κ*] (m, m, m, 1/m), not yet z-scored.
pub fn feature(point: &Point3<f64>, pseudo_curvature: f64) -> Vector4<f64> {
    Vector4::new(point.x, point.y, point.z, pseudo_curvature)
}

/// Classification by minimum intra-class distance (MICD): a point belongs to the patch with the least
/// d² = (x − μ)ᵀ S⁻¹ (x − μ), where x are its z-scored features, μ and S the patch's mean and covariance.
#[derive(Clone, Debug)]
pub struct Classifier {
    origin: Vector4<f64>,
    scale: Vector4<f64>,
    patches: Vec<(Vector4<f64>, Matrix4<f64>)>,
}

impl Classifier {
    /// The classifier of a partition; `None` when a covariance is not positive definite, a scale not positive,
    /// or there are no patches.
    pub fn new(partition: &Partition) -> Option<Self> {
        Self::from_statistics(partition.feature_mean, partition.feature_scale, &partition.patches)
    }

    /// The same from its parts: origin and scale of the z-score (m, m, m, 1/m) and the patches' statistics.
    pub fn from_statistics(
        origin: Vector4<f64>,
        scale: Vector4<f64>,
        patches: &[PatchStatistics],
    ) -> Option<Self> {
        let finite = origin.iter().all(|v| v.is_finite()) && scale.iter().all(|v| v.is_finite() && *v > 0.0);
        if !finite || patches.is_empty() {
            return None;
        }
        let patches = patches
            .iter()
            .map(|p| Some((p.mean, p.covariance.cholesky()?.inverse())))
            .collect::<Option<_>>()?;
        Some(Self { origin, scale, patches })
    }

    /// Patch of a point with these features ([`feature`], not z-scored): the one of least distance, of equals
    /// the first.
    pub fn classify(&self, feature: &Vector4<f64>) -> usize {
        self.nearest(feature).0
    }

    /// Patch of a point and its squared intra-class distance d² (dimensionless).
    pub fn nearest(&self, feature: &Vector4<f64>) -> (usize, f64) {
        let mut best = (0, f64::INFINITY);
        for patch in 0..self.patches.len() {
            let distance = self.distance(feature, patch);
            if distance < best.1 {
                best = (patch, distance);
            }
        }
        best
    }

    /// Squared intra-class distance d² (dimensionless) of a point to one patch.
    ///
    /// # Panics
    /// If there is no such patch.
    pub fn distance(&self, feature: &Vector4<f64>, patch: usize) -> f64 {
        let (mean, inverse) = &self.patches[patch];
        let d = (feature - self.origin).component_div(&self.scale) - mean;
        d.dot(&(inverse * d))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn patch(mean: f64, variance: f64) -> PatchStatistics {
        PatchStatistics {
            mean: Vector4::new(mean, 0.0, 0.0, 0.0),
            covariance: Matrix4::identity() * variance,
            sample_count: 1,
            parts: vec![1],
        }
    }

    #[test]
    fn wide_patch_reaches_further_than_narrow_one() {
        let patches = [patch(0.0, 4.0), patch(3.0, 1.0)];
        let classifier =
            Classifier::from_statistics(Vector4::zeros(), Vector4::repeat(2.0), &patches).unwrap();
        // Equal distances at z-score 2 (2/√4 = 1/√1): the border, 4 in unscaled units; a tie goes to the first.
        assert_eq!(classifier.classify(&Vector4::new(3.99, 0.0, 0.0, 0.0)), 0);
        assert_eq!(classifier.classify(&Vector4::new(4.0, 0.0, 0.0, 0.0)), 0);
        assert_eq!(classifier.classify(&Vector4::new(4.01, 0.0, 0.0, 0.0)), 1);
        let (nearest, distance) = classifier.nearest(&Vector4::new(6.0, 0.0, 0.0, 2.0));
        assert_eq!(nearest, 1);
        assert!((distance - 1.0).abs() < 1e-12);
    }

    #[test]
    fn statistics_that_cannot_classify_are_refused() {
        let make = |scale, patches: &[PatchStatistics]| {
            Classifier::from_statistics(Vector4::zeros(), Vector4::repeat(scale), patches)
        };
        assert!(make(1.0, &[]).is_none());
        assert!(make(0.0, &[patch(0.0, 1.0)]).is_none());
        assert!(make(f64::NAN, &[patch(0.0, 1.0)]).is_none());
        assert!(make(1.0, &[patch(0.0, 0.0)]).is_none());
        assert!(make(1.0, &[patch(0.0, f64::NAN)]).is_none());
    }
}
