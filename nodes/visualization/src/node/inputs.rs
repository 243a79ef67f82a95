//! What has come, joined by surface, job and stamp: which inputs each topic is drawn from.

use std::sync::Arc;

use patchmill_geometry::mesh::TriangleMesh;
use patchmill_msgs::builtin_interfaces::msg::Time;
use patchmill_node_runtime::JobTag;
use patchmill_products::evaluation::ResidualMap;
use patchmill_products::field::RollingBallField;
use patchmill_products::job::Job;
use patchmill_products::partition::Partition;
use patchmill_products::samples::SurfaceSamples;
use patchmill_products::toolpath::CandidateToolpath;

/// An input with what it belongs to, and a number that no other input has.
pub(super) struct Input<T> {
    pub(super) tag: JobTag,
    number: u64,
    pub(super) value: Arc<T>,
}

impl<T> Clone for Input<T> {
    fn clone(&self) -> Self {
        Self { tag: self.tag.clone(), number: self.number, value: Arc::clone(&self.value) }
    }
}

/// The inputs of a drawing by number: equal keys, equal drawings. Nothing to draw has no inputs.
pub(super) type Key = Vec<u64>;

/// Whose plan is shown.
#[derive(Default)]
enum Wanted {
    /// No job has come yet: the surface alone.
    #[default]
    Surface,
    /// The job was withdrawn.
    Nothing,
    Plan(Input<Job>),
}

/// The newest input of each kind.
#[derive(Default)]
pub(super) struct Inputs {
    count: u64,
    wanted: Wanted,
    mesh: Option<Input<TriangleMesh>>,
    samples: Option<Input<SurfaceSamples>>,
    field: Option<Input<RollingBallField>>,
    /// Of one run of a job.
    partitions: Vec<Input<Partition>>,
    toolpaths: Vec<Input<CandidateToolpath>>,
    chosen: Option<(JobTag, Option<u32>)>,
    residual: Option<Input<ResidualMap>>,
}

impl Inputs {
    fn input<T>(&mut self, tag: JobTag, value: T) -> Input<T> {
        self.count += 1;
        Input { tag, number: self.count, value: Arc::new(value) }
    }

    /// A job, or its withdrawal.
    pub(super) fn put_job(&mut self, job: Option<(JobTag, Job)>) {
        self.wanted = match job {
            Some((tag, job)) => Wanted::Plan(self.input(tag, job)),
            None => Wanted::Nothing,
        };
    }

    pub(super) fn put_mesh(&mut self, tag: JobTag, mesh: TriangleMesh) {
        self.mesh = Some(self.input(tag, mesh));
    }

    pub(super) fn put_samples(&mut self, tag: JobTag, samples: SurfaceSamples) {
        self.samples = Some(self.input(tag, samples));
    }

    pub(super) fn put_field(&mut self, tag: JobTag, field: RollingBallField) {
        self.field = Some(self.input(tag, field));
    }

    pub(super) fn put_partition(&mut self, tag: JobTag, partition: Partition) {
        let new = self.input(tag, partition);
        self.partitions.retain(|old| old.tag == new.tag && old.value.index != new.value.index);
        self.partitions.push(new);
    }

    pub(super) fn put_toolpath(&mut self, tag: JobTag, toolpath: CandidateToolpath) {
        let new = self.input(tag, toolpath);
        self.toolpaths.retain(|old| old.tag == new.tag && old.value.index != new.value.index);
        self.toolpaths.push(new);
    }

    /// The choice of an evaluation: a candidate's index, or none.
    pub(super) fn put_choice(&mut self, tag: JobTag, chosen: Option<u32>) {
        self.chosen = Some((tag, chosen));
    }

    pub(super) fn put_residual(&mut self, tag: JobTag, map: ResidualMap) {
        self.residual = Some(self.input(tag, map));
    }

    /// Inputs of the cloud of what is left.
    pub(super) fn residual(&self) -> (Key, Option<ResidualInputs>) {
        let inputs = self.job().and_then(|job| {
            let map = self.residual.as_ref().filter(|map| map.tag == job.tag)?;
            Some(ResidualInputs { job: job.clone(), map: map.clone() })
        });
        (inputs.as_ref().map_or_else(Key::new, |i| vec![i.job.number, i.map.number]), inputs)
    }

    fn job(&self) -> Option<&Input<Job>> {
        if let Wanted::Plan(job) = &self.wanted { Some(job) } else { None }
    }

    /// Inputs of the drawing of the tool.
    pub(super) fn tool(&self) -> (Key, Option<Input<Job>>) {
        (self.job().map(|job| job.number).into_iter().collect(), self.job().cloned())
    }

    /// Inputs of the drawing of the patches.
    pub(super) fn patches(&self) -> (Key, Option<PatchInputs>) {
        let job = self.job();
        let shown = match (&self.wanted, job) {
            (Wanted::Nothing, _) => None,
            (_, Some(job)) => self.mesh.as_ref().filter(|m| m.tag.surface_id == job.tag.surface_id),
            (_, None) => self.mesh.as_ref(),
        };
        let Some(mesh) = shown.cloned() else { return (Key::new(), None) };
        let plan = self.plan().and_then(|plan| Some((plan, self.field_of(job?)?)));
        let mut key = vec![mesh.number];
        key.extend(job.map(|job| job.number));
        if let Some((plan, field)) = &plan {
            key.extend([plan.samples.number, plan.partition.number, field.number]);
        }
        let stamp = job.map_or(&mesh.tag.stamp, |job| &job.tag.stamp).clone();
        (key, Some(PatchInputs { stamp, mesh, plan }))
    }

    /// Inputs of the drawings of passes and axes: the chosen candidate.
    pub(super) fn plan(&self) -> Option<PlanInputs> {
        let job = self.job()?;
        let (tag, chosen) = self.chosen.as_ref()?;
        let chosen = (*tag == job.tag).then_some(*chosen).flatten()?;
        let partition = self.partitions.iter().find(|p| p.tag == job.tag && p.value.index == chosen)?;
        let toolpath = self.toolpaths.iter().find(|t| t.tag == job.tag && t.value.index == chosen)?;
        let samples = self.samples_of(job)?;
        Some(PlanInputs {
            stamp: job.tag.stamp.clone(),
            key: vec![job.number, samples.number, partition.number, toolpath.number],
            samples,
            partition: partition.clone(),
            toolpath: toolpath.clone(),
        })
    }

    /// Inputs of the cloud.
    pub(super) fn cloud(&self) -> (Key, Option<CloudInputs>) {
        let inputs = self.job().and_then(|job| Some((job, self.samples_of(job)?, self.field_of(job)?)));
        match inputs {
            Some((job, samples, field)) => (
                vec![job.number, samples.number, field.number],
                Some(CloudInputs { stamp: job.tag.stamp.clone(), samples, field }),
            ),
            None => (Key::new(), None),
        }
    }

    fn samples_of(&self, job: &Input<Job>) -> Option<Input<SurfaceSamples>> {
        self.samples.as_ref().filter(|s| s.tag.surface_id == job.tag.surface_id).cloned()
    }

    fn field_of(&self, job: &Input<Job>) -> Option<Input<RollingBallField>> {
        self.field.as_ref().filter(|f| f.tag == job.tag).cloned()
    }
}

/// The surface, and the chosen candidate with the field when there is one.
pub(super) struct PatchInputs {
    pub(super) stamp: Time,
    pub(super) mesh: Input<TriangleMesh>,
    pub(super) plan: Option<(PlanInputs, Input<RollingBallField>)>,
}

/// The chosen candidate.
pub(super) struct PlanInputs {
    pub(super) stamp: Time,
    pub(super) key: Key,
    pub(super) samples: Input<SurfaceSamples>,
    pub(super) partition: Input<Partition>,
    pub(super) toolpath: Input<CandidateToolpath>,
}

/// The samples with their field.
pub(super) struct CloudInputs {
    pub(super) stamp: Time,
    pub(super) samples: Input<SurfaceSamples>,
    pub(super) field: Input<RollingBallField>,
}

/// What the job's program leaves.
pub(super) struct ResidualInputs {
    pub(super) job: Input<Job>,
    pub(super) map: Input<ResidualMap>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector4;

    fn tag(surface: &str, job: &str, sec: i32) -> JobTag {
        JobTag { surface_id: surface.to_owned(), job_id: job.to_owned(), stamp: Time { sec, nanosec: 0 } }
    }

    fn partition(index: u32) -> Partition {
        Partition {
            index,
            count: 2,
            feature_mean: Vector4::zeros(),
            feature_scale: Vector4::repeat(1.0),
            labels: Vec::new(),
            patches: Vec::new(),
            inertia: 0.0,
        }
    }

    fn toolpath(index: u32) -> CandidateToolpath {
        CandidateToolpath {
            index,
            count: 2,
            patch_count: 1,
            infeasible_reason: String::new(),
            patches: Vec::new(),
            area_within_scallop: 1.0,
            gouge_max: 0.0,
        }
    }

    type Put = fn(&mut Inputs);

    fn job_a(inputs: &mut Inputs) {
        inputs.put_job(Some((tag("s", "j", 1), Job::default_for("s"))));
    }

    /// Everything of a plan, in some order.
    const PLAN: [Put; 10] = [
        job_a,
        |i| i.put_mesh(tag("s", "", 0), TriangleMesh::default()),
        |i| i.put_samples(tag("s", "", 0), SurfaceSamples::default()),
        |i| i.put_field(tag("s", "j", 1), RollingBallField::default()),
        |i| i.put_partition(tag("s", "j", 1), partition(0)),
        |i| i.put_partition(tag("s", "j", 1), partition(1)),
        |i| i.put_toolpath(tag("s", "j", 1), toolpath(1)),
        |i| i.put_toolpath(tag("s", "j", 1), toolpath(0)),
        |i| i.put_choice(tag("s", "j", 1), Some(1)),
        |i| i.put_residual(tag("s", "j", 1), ResidualMap::default()),
    ];
    /// Those of them that passes and axes are drawn from: job, samples, the chosen partition and toolpath, the choice.
    const DRAWN: [usize; 5] = [0, 2, 5, 6, 8];

    #[test]
    fn a_plan_is_the_same_in_whatever_order_it_comes() {
        for first in 0..PLAN.len() {
            let mut inputs = Inputs::default();
            let mut put = Vec::new();
            for place in 0..PLAN.len() {
                let complete = DRAWN.iter().all(|needed| put.contains(needed));
                assert_eq!(inputs.plan().is_some(), complete, "{put:?}");
                let next = (first + place * 3) % PLAN.len();
                PLAN[next](&mut inputs);
                put.push(next);
            }
            let plan = inputs.plan().unwrap();
            assert_eq!((plan.partition.value.index, plan.toolpath.value.index), (1, 1));
            assert!(inputs.patches().1.unwrap().plan.is_some() && inputs.cloud().1.is_some());
            assert!(inputs.residual().1.is_some());
        }
    }

    fn planned() -> Inputs {
        let mut inputs = Inputs::default();
        PLAN.iter().for_each(|put| put(&mut inputs));
        inputs
    }

    #[test]
    fn what_belongs_to_another_run_or_surface_is_not_drawn() {
        let mut inputs = planned();
        // The same job again, later: nothing of the older run is drawn for it but the surface.
        inputs.put_job(Some((tag("s", "j", 2), Job::default_for("s"))));
        assert!(inputs.plan().is_none() && inputs.cloud().0.is_empty() && inputs.residual().1.is_none());
        let patches = inputs.patches().1.unwrap();
        assert!(patches.plan.is_none() && patches.stamp.sec == 2);
        inputs.put_job(Some((tag("other", "k", 3), Job::default_for("other"))));
        assert!(inputs.patches().0.is_empty() && inputs.patches().1.is_none());
        job_a(&mut inputs);
        assert!(inputs.plan().is_some());
        inputs.put_mesh(tag("other", "", 0), TriangleMesh::default());
        assert!(inputs.patches().1.is_none());
    }

    #[test]
    fn a_withdrawn_job_leaves_nothing() {
        let mut inputs = planned();
        inputs.put_job(None);
        assert!(inputs.plan().is_none() && inputs.patches().0.is_empty());
        assert!(inputs.cloud().0.is_empty() && inputs.tool().0.is_empty());
    }

    #[test]
    fn before_the_first_job_the_surface_is_drawn_alone() {
        let mut inputs = Inputs::default();
        inputs.put_mesh(tag("s", "", 5), TriangleMesh::default());
        let patches = inputs.patches().1.unwrap();
        assert!(patches.plan.is_none() && patches.stamp.sec == 5);
    }

    #[test]
    fn keys_change_with_what_is_drawn_and_with_nothing_else() {
        let mut inputs = planned();
        let (patches, plan) = (inputs.patches().0, inputs.plan().unwrap().key);
        inputs.put_partition(tag("s", "j", 1), partition(0));
        assert_eq!((&inputs.patches().0, &inputs.plan().unwrap().key), (&patches, &plan));
        inputs.put_partition(tag("s", "j", 1), partition(1));
        assert!(inputs.patches().0 != patches && inputs.plan().unwrap().key != plan);
        inputs.put_choice(tag("s", "j", 1), None);
        assert!(inputs.plan().is_none() && inputs.patches().1.unwrap().plan.is_none());
    }
}
