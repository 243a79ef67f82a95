//! The joint motion as messages.

use patchmill_msgs::builtin_interfaces::msg::Duration;
use patchmill_msgs::msg::{TrajectoryChunk, TrajectoryManifest};
use patchmill_msgs::trajectory_msgs::msg::JointTrajectory;

use super::chunked::{CHUNK_DATA, Chunked, heads_of_job};
use super::hash::ContentHash;
use super::{Provenance, WireError, check};
use crate::program::JointMotion;

/// Most points of a motion, most joints, longest name of a joint in bytes.
const LIMIT: u32 = 20_000_000;
const JOINT_LIMIT: usize = 32;
const NAME_LIMIT: usize = 64;

/// Longest motion, s, so that a nanosecond still counts in f64.
const LONGEST: f64 = 1e6;

/// Bytes of a point without its positions and velocities: time, four lengths, padding.
const POINT_BYTES: usize = 48;

impl Chunked for JointMotion {
    const WHAT: &'static str = "joint trajectory";
    type Manifest = TrajectoryManifest;
    type Chunk = TrajectoryChunk;

    fn split(
        &self,
        provenance: &Provenance,
    ) -> Result<(TrajectoryManifest, Vec<TrajectoryChunk>), WireError> {
        self.check()?;
        let joints = self.joint_names.len();
        // The joints' names, at most 32 of 64 bytes, come out of the chunk's data.
        let per_chunk = (CHUNK_DATA - JOINT_LIMIT * (NAME_LIMIT + 8)) / (POINT_BYTES + 16 * joints);
        let chunk_count = self.times.len().div_ceil(per_chunk) as u32;
        let chunk = |index: u32| {
            let first = index as usize * per_chunk;
            TrajectoryChunk {
                header: provenance.header(),
                surface_id: provenance.surface_id.clone(),
                job_id: provenance.job_id.clone(),
                index,
                count: chunk_count,
                trajectory: JointTrajectory {
                    header: provenance.header(),
                    joint_names: self.joint_names.clone(),
                    points: (first..self.times.len().min(first + per_chunk))
                        .map(|at| self.point(at))
                        .collect(),
                },
            }
        };
        let manifest = TrajectoryManifest {
            header: provenance.header(),
            surface_id: provenance.surface_id.clone(),
            job_id: provenance.job_id.clone(),
            content_hash: self.content_hash(),
            chunk_count,
            point_count: self.times.len() as u32,
            duration: self.times.last().copied().unwrap_or(0.0),
            joint_names: self.joint_names.clone(),
        };
        Ok((manifest, (0..chunk_count).map(chunk).collect()))
    }

    fn join(manifest: &TrajectoryManifest, chunks: Vec<TrajectoryChunk>) -> Result<Self, WireError> {
        let count = chunks.iter().map(|chunk| chunk.trajectory.points.len()).sum();
        check::count("points", manifest.point_count, count, LIMIT)?;
        let joints = manifest.joint_names.len();
        let mut motion = Self { joint_names: manifest.joint_names.clone(), ..Self::default() };
        for chunk in chunks {
            let names = &chunk.trajectory.joint_names;
            let expected = format!("{:?} as in the manifest", motion.joint_names);
            check::expect(*names == motion.joint_names, "a chunk's joints", format!("{names:?}"), &expected)?;
            for point in chunk.trajectory.points {
                check::same_length("positions of a point", point.positions.len(), joints)?;
                check::same_length("velocities of a point", point.velocities.len(), joints)?;
                motion.times.push(seconds(&point.time_from_start));
                motion.positions.extend(point.positions);
                motion.velocities.extend(point.velocities);
            }
        }
        Ok(motion)
    }

    fn check(&self) -> Result<(), WireError> {
        let (joints, points) = (self.joint_names.len(), self.times.len());
        let expected = format!("1 to {JOINT_LIMIT}");
        check::expect((1..=JOINT_LIMIT).contains(&joints), "the number of joints", joints, &expected)?;
        let longest = self.joint_names.iter().map(String::len).max().unwrap_or(0);
        let expected = format!("at most {NAME_LIMIT}");
        check::expect(longest <= NAME_LIMIT, "the longest joint name in bytes", longest, &expected)?;
        check::expect(points <= LIMIT as usize, "the number of points", points, &format!("at most {LIMIT}"))?;
        check::same_length("positions", self.positions.len(), points * joints)?;
        check::same_length("velocities", self.velocities.len(), points * joints)?;
        check::all_finite("position", &self.positions)?;
        check::all_finite("velocity", &self.velocities)?;
        let mut before = 0.0;
        for (at, &time) in self.times.iter().enumerate() {
            check::within(&format!("the time of point {at}"), time, before, LONGEST)?;
            before = time;
        }
        Ok(())
    }

    fn content_hash(&self) -> String {
        let mut hash = ContentHash::default();
        hash.length(self.joint_names.len());
        self.joint_names.iter().for_each(|name| hash.text(name));
        hash.length(self.times.len());
        self.times.iter().map(|t| nanoseconds(*t)).for_each(|t| hash.bytes(&t.to_le_bytes()));
        hash.numbers(&self.positions);
        hash.numbers(&self.velocities);
        hash.hex()
    }

    heads_of_job!();
}

/// Whole nanoseconds of a time in s within 0 and `LONGEST`.
pub(super) fn nanoseconds(time: f64) -> u64 {
    // Seconds and their fraction apart: the product of a long time and 1e9 would lose nanoseconds.
    (time.trunc() as u64) * 1_000_000_000 + (time.fract() * 1e9).round() as u64
}

pub(super) fn duration(time: f64) -> Duration {
    let ns = nanoseconds(time);
    Duration { sec: (ns / 1_000_000_000) as i32, nanosec: (ns % 1_000_000_000) as u32 }
}

fn seconds(duration: &Duration) -> f64 {
    f64::from(duration.sec) + f64::from(duration.nanosec) * 1e-9
}
