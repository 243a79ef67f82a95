//! The joint motion as plain `trajectory_msgs/JointTrajectory`, for controllers that know nothing of patchmill.

use patchmill_msgs::std_msgs::msg::Header;
use patchmill_msgs::trajectory_msgs::msg::{JointTrajectory, JointTrajectoryPoint};

use super::trajectory::{duration, nanoseconds};
use super::{Chunked, MAX_CHUNK_BYTES, WireError, check};
use crate::program::JointMotion;

/// Speed that counts as rest, m/s or rad/s: what ros2_control's joint trajectory controller takes for zero.
const REST: f64 = f32::EPSILON as f64;

/// Bytes of a point without its positions and velocities, and most bytes of a header and joint names.
const POINT_BYTES: usize = 48;
const HEAD_BYTES: usize = 4096;

impl JointMotion {
    /// The motion in the convention of ros2_control's joint trajectory controller, in parts of at most
    /// [`MAX_CHUNK_BYTES`] of CDR.
    ///
    /// Time counts from the motion's start in every part, so that the parts' points one after the other are one goal:
    /// positions [m, rad] and velocities [m/s, rad/s] of every joint in every point, times strictly increasing in whole
    /// nanoseconds, rest in the first and the last point, no accelerations or efforts, stamp zero (start at once). Of
    /// points within the same nanosecond one is kept, at the end the last.
    ///
    /// # Errors
    /// When the motion is not valid ([`Chunked::check`]), or does not start and end at rest.
    pub fn to_joint_trajectories(&self) -> Result<Vec<JointTrajectory>, WireError> {
        self.check()?;
        let kept = self.distinct_points();
        for (what, at) in [("first", kept.first()), ("last", kept.last())] {
            let fastest =
                at.map_or(0.0, |&at| self.velocities_at(at).iter().fold(0.0, |m, v| f64::max(m, v.abs())));
            check::expect(fastest <= REST, &format!("the speed at the {what} point"), fastest, "rest")?;
        }
        let per_part = (MAX_CHUNK_BYTES - HEAD_BYTES) / (POINT_BYTES + 16 * self.joint_names.len());
        let part = |points: &[usize]| JointTrajectory {
            header: Header::default(),
            joint_names: self.joint_names.clone(),
            points: points.iter().map(|&at| self.point(at)).collect(),
        };
        Ok(kept.chunks(per_part).map(part).collect())
    }

    /// One point as a message; `at` counts from 0.
    pub(super) fn point(&self, at: usize) -> JointTrajectoryPoint {
        let joints = self.joint_names.len();
        JointTrajectoryPoint {
            positions: self.positions[at * joints..(at + 1) * joints].to_vec(),
            velocities: self.velocities_at(at).to_vec(),
            accelerations: Vec::new(),
            effort: Vec::new(),
            time_from_start: duration(self.times[at]),
        }
    }

    fn velocities_at(&self, at: usize) -> &[f64] {
        let joints = self.joint_names.len();
        &self.velocities[at * joints..(at + 1) * joints]
    }

    /// Points whose times differ in whole nanoseconds. The last point always stays: it is at rest.
    fn distinct_points(&self) -> Vec<usize> {
        let mut kept: Vec<usize> = (0..self.times.len()).collect();
        kept.dedup_by_key(|at| nanoseconds(self.times[*at]));
        if let (Some(end), Some(last)) = (self.times.len().checked_sub(1), kept.last_mut()) {
            *last = end;
        }
        kept
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use patchmill_msgs::cdr::to_cdr;

    /// A motion of two joints with these times.
    fn motion(times: Vec<f64>) -> JointMotion {
        let n = times.len();
        let mut velocities = vec![0.1; 2 * n];
        velocities[..2].fill(0.0);
        velocities[2 * n - 2..].fill(0.0);
        JointMotion {
            joint_names: vec!["x".to_owned(), "c".to_owned()],
            positions: (0..2 * n).map(|i| i as f64).collect(),
            velocities,
            times,
        }
    }

    fn joined(parts: &[JointTrajectory]) -> Vec<JointTrajectoryPoint> {
        parts.iter().flat_map(|p| p.points.clone()).collect()
    }

    #[test]
    fn parts_are_one_goal_of_a_joint_trajectory_controller() {
        let motion = motion((0..3000).map(|i| f64::from(i) * 0.0101).collect());
        let parts = motion.to_joint_trajectories().unwrap();
        assert!(parts.len() > 3);
        for part in &parts {
            assert!(to_cdr(part).len() <= MAX_CHUNK_BYTES, "{}", to_cdr(part).len());
            assert_eq!(part.joint_names, ["x", "c"]);
            assert_eq!(part.header, Header::default());
        }
        let points = joined(&parts);
        assert_eq!(points.len(), 3000);
        let ns = |p: &JointTrajectoryPoint| {
            i64::from(p.time_from_start.sec) * 1_000_000_000 + i64::from(p.time_from_start.nanosec)
        };
        assert!(points.windows(2).all(|w| ns(&w[0]) < ns(&w[1])));
        assert_eq!((ns(&points[0]), ns(&points[2999])), (0, 30_289_900_000));
        assert!(points.iter().all(|p| p.positions.len() == 2 && p.velocities.len() == 2));
        assert!(points.iter().all(|p| p.accelerations.is_empty() && p.effort.is_empty()));
        assert_eq!(points[1234].positions, [2468.0, 2469.0]);
    }

    #[test]
    fn points_of_the_same_nanosecond_become_one() {
        let parts =
            motion(vec![0.0, 0.5, 0.500_000_000_3, 1.0, 1.000_000_000_2]).to_joint_trajectories().unwrap();
        let points = joined(&parts);
        // The end keeps the point at rest, in the middle the first stays.
        let firsts: Vec<f64> = points.iter().map(|p| p.positions[0]).collect();
        assert_eq!(firsts, [0.0, 2.0, 8.0]);
        assert_eq!(points[2].velocities, [0.0, 0.0]);
    }

    #[test]
    fn motion_that_does_not_rest_at_its_ends_is_refused() {
        let mut moving = motion(vec![0.0, 1.0, 2.0]);
        moving.velocities[5] = 1e-3;
        assert!(moving.to_joint_trajectories().unwrap_err().text.contains("the last point"));
        assert!(motion(vec![0.0, 1.0]).to_joint_trajectories().is_ok());
    }

    #[test]
    fn nothing_is_no_part() {
        let empty = JointMotion { joint_names: vec!["x".to_owned()], ..JointMotion::default() };
        assert!(empty.to_joint_trajectories().unwrap().is_empty());
    }
}
