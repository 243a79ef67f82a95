//! Shank and holder over the part: whether they touch it, and how far they would have to be raised.
//!
//! Only what is wider than the cutter counts: the drops keep the cutter's own cylinder, endless upward, clear. The stacks
//! are grown by a margin, so that what is looked at every `SPACING` of a pass holds for the whole pass. The part is the
//! surface's mesh; neither stock nor clamps are known.

use nalgebra::{Point3, Rotation3, Unit, Vector3};
use patchmill_geometry::bvh::Bvh;
use patchmill_geometry::mesh::TriangleMesh;
use patchmill_geometry::tool_stack::{StackDrop, ToolStack, Touch};
use patchmill_products::job::Job;
use patchmill_products::toolpath::Pass;
use rayon::prelude::*;

/// Margin while an axis is chosen, m.
const CHOOSING: f64 = 0.5e-3;
/// Margin that the finished passes have to keep, m: less, so that passes spaced anew do not fall through.
const FINISHED: f64 = 0.3e-3;
/// Moves are looked at no coarser than this, m. The program's proof has a margin of 0.15 mm: it finds nothing new.
const SPACING: f64 = 0.2e-3;

/// Shank and holder of a job's tool.
#[derive(Clone, Debug)]
pub struct Assembly {
    shank: ToolStack,
    holder: ToolStack,
}

/// Where shank and holder touch worst.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Collision {
    /// The shank, whose raise is flute length lacking.
    pub shank: Option<Touch>,
    /// The holder, whose raise is stick-out lacking.
    pub holder: Option<Touch>,
}

impl Collision {
    /// Nothing touches.
    pub fn is_clear(&self) -> bool {
        self.shank.is_none() && self.holder.is_none()
    }

    /// The worse of both, part by part.
    pub fn worse(self, other: Self) -> Self {
        Self { shank: Touch::worse(self.shank, other.shank), holder: Touch::worse(self.holder, other.holder) }
    }

    /// Raise lacking of shank and holder, m, for comparison: a shank that touches is worse than any holder.
    pub fn raises(&self) -> [f64; 2] {
        [self.shank, self.holder].map(|touch| touch.map_or(0.0, |t| t.raise))
    }
}

impl Assembly {
    /// The parts of the job's tool that are wider than its cutter, for choosing axes; `None` when there are none.
    pub fn for_choosing(job: &Job) -> Option<Self> {
        Self::with_margin(job, CHOOSING)
    }

    /// The same for the last look at finished passes.
    pub fn for_finished(job: &Job) -> Option<Self> {
        Self::with_margin(job, FINISHED)
    }

    fn with_margin(job: &Job, margin: f64) -> Option<Self> {
        let [shank, holder] = job.tool.wide_stacks(margin + job.stock_allowance);
        (!shank.is_empty() || !holder.is_empty()).then_some(Self { shank, holder })
    }
}

/// An assembly held along one axis over a mesh.
#[derive(Clone, Copy, Debug)]
pub struct HeldAssembly<'a> {
    assembly: &'a Assembly,
    drop: StackDrop<'a>,
}

impl<'a> HeldAssembly<'a> {
    /// Holds it; `frame` is tool_from_workpiece.
    pub fn new(assembly: &'a Assembly, mesh: &'a TriangleMesh, bvh: &'a Bvh, frame: Rotation3<f64>) -> Self {
        Self { assembly, drop: StackDrop::new(mesh, bvh, frame) }
    }

    /// The lowest tip over (x, y), tool frame, at which nothing touches, but at least `floor`, m.
    pub fn lowest_tip(&self, x: f64, y: f64, floor: f64) -> f64 {
        let over = |stack, floor| self.drop.lowest_tip(stack, x, y, floor).unwrap_or(floor);
        over(&self.assembly.holder, over(&self.assembly.shank, floor))
    }

    /// Whether something touches with the tip at one of `tips`, `workpiece` frame.
    pub fn touches(&self, tips: &[Point3<f64>]) -> bool {
        let Assembly { shank, holder } = self.assembly;
        tips.par_iter().any(|tip| [holder, shank].iter().any(|s| self.drop.touch(s, tip, 0.0).is_some()))
    }

    /// The worst touches with the tip at `tips`, `workpiece` frame.
    pub fn collision(&self, tips: &[Point3<f64>]) -> Collision {
        self.worst(tips, |stack, tip| self.drop.touch(stack, tip, 0.0))
    }

    /// The worst touches along the passes of a patch and the rapids between them, `workpiece` frame.
    pub fn collision_along(&self, passes: &[Pass], axis: &Unit<Vector3<f64>>) -> Collision {
        self.worst(&moves(passes, axis), |stack, [from, to]| self.drop.touch_along(stack, from, to, SPACING))
    }

    fn worst<T: Sync>(
        &self,
        places: &[T],
        touch: impl Fn(&ToolStack, &T) -> Option<Touch> + Sync,
    ) -> Collision {
        let Assembly { shank, holder } = self.assembly;
        let at = |place: &T| Collision { shank: touch(shank, place), holder: touch(holder, place) };
        places.par_iter().map(at).reduce(Collision::default, Collision::worse)
    }
}

/// The straight moves of the tip: along the passes, and across at the height of each pass's lift. The lifts themselves
/// only take the tool away.
fn moves(passes: &[Pass], axis: &Unit<Vector3<f64>>) -> Vec<[Point3<f64>; 2]> {
    let single = |pass: &Pass| (pass.cl.len() == 1).then(|| [pass.cl[0]; 2]);
    let mut moves: Vec<[Point3<f64>; 2]> = passes.iter().filter_map(single).collect();
    moves.extend(passes.iter().flat_map(|pass| pass.cl.windows(2).map(|w| [w[0], w[1]])));
    let lifted =
        |tip: &Point3<f64>, height: f64| tip + axis.into_inner() * (height - tip.coords.dot(axis)).max(0.0);
    for pair in passes.windows(2) {
        if let (Some(end), Some(start)) = (pair[0].cl.last(), pair[1].cl.first())
            && (end - start).norm() > 1e-9
        {
            moves.push([end, start].map(|tip| lifted(tip, pair[0].retract_height)));
        }
    }
    moves
}
