//! A candidate partition as a message.

use nalgebra::{Matrix4, Vector4};
use patchmill_msgs::msg;

use super::job::MAX_PATCHES;
use super::{Provenance, WireError, check};
use crate::partition::{Partition, PatchStatistics};

impl Partition {
    /// The partition's message.
    ///
    /// # Errors
    /// When the partition is not valid, as [`Partition::check`] says.
    pub fn to_msg(&self, provenance: &Provenance) -> Result<msg::PartitionCandidate, WireError> {
        self.check()?;
        Ok(msg::PartitionCandidate {
            header: provenance.header(),
            surface_id: provenance.surface_id.clone(),
            job_id: provenance.job_id.clone(),
            index: self.index,
            count: self.count,
            feature_mean: self.feature_mean.into(),
            feature_scale: self.feature_scale.into(),
            labels: self.labels.clone(),
            patches: self.patches.iter().map(statistics_msg).collect(),
            inertia: self.inertia,
        })
    }

    /// The partition of a message and its origin.
    ///
    /// # Errors
    /// When the message is not valid.
    pub fn from_msg(msg: &msg::PartitionCandidate) -> Result<(Provenance, Self), WireError> {
        let provenance = Provenance::read(&msg.header, &msg.surface_id, &msg.job_id)?;
        let partition = Self {
            index: msg.index,
            count: msg.count,
            feature_mean: Vector4::from(msg.feature_mean),
            feature_scale: Vector4::from(msg.feature_scale),
            labels: msg.labels.clone(),
            patches: msg.patches.iter().map(statistics).collect(),
            inertia: msg.inertia,
        };
        partition.check()?;
        Ok((provenance, partition))
    }

    /// Whether numbers are finite, scales positive, labels and index in range, covariances symmetric.
    ///
    /// # Errors
    /// With the first thing that is not.
    pub fn check(&self) -> Result<(), WireError> {
        let within = format!("less than {}", self.count);
        check::expect(self.index < self.count, "the candidate's index", self.index, &within)?;
        let patches = self.patches.len();
        let expected = format!("1 to {MAX_PATCHES}");
        check::expect(
            (1..=usize::from(MAX_PATCHES)).contains(&patches),
            "the number of patches",
            patches,
            &expected,
        )?;
        check::all_finite("feature mean", self.feature_mean.as_slice())?;
        check::all_finite("feature scale", self.feature_scale.as_slice())?;
        let least = self.feature_scale.min();
        check::expect(least > 0.0, "the least feature scale", least, "a positive number")?;
        if let Some(at) = self.labels.iter().position(|&label| usize::from(label) >= patches) {
            let label = self.labels[at];
            check::expect(
                false,
                &format!("the label of sample {at}"),
                label,
                &format!("less than {patches}"),
            )?;
        }
        for (at, patch) in self.patches.iter().enumerate() {
            check::all_finite(&format!("patch {at}: mean"), patch.mean.as_slice())?;
            check::all_finite(&format!("patch {at}: covariance"), patch.covariance.as_slice())?;
            let skew = (patch.covariance - patch.covariance.transpose()).amax();
            let symmetric = skew <= 1e-9 * patch.covariance.amax();
            check::expect(symmetric, &format!("patch {at}: the covariance's asymmetry"), skew, "none")?;
        }
        check::not_negative("inertia", self.inertia)
    }
}

fn statistics_msg(patch: &PatchStatistics) -> msg::PatchStatistics {
    msg::PatchStatistics {
        mean: patch.mean.into(),
        covariance: std::array::from_fn(|i| patch.covariance[(i / 4, i % 4)]),
        sample_count: patch.sample_count,
        parts: patch.parts.clone(),
    }
}

fn statistics(patch: &msg::PatchStatistics) -> PatchStatistics {
    PatchStatistics {
        mean: Vector4::from(patch.mean),
        covariance: Matrix4::from_row_slice(&patch.covariance),
        sample_count: patch.sample_count,
        parts: patch.parts.clone(),
    }
}
