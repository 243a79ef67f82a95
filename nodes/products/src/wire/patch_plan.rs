//! A patch without its passes as a message, shared by toolpath and program.

use patchmill_msgs::msg;

use super::hash::ContentHash;
use super::vectors::{vector, vector_msg};
use super::{WireError, check};
use crate::program::PatchPlan;

pub(super) fn plan_msg(plan: &PatchPlan) -> msg::PatchPlan {
    msg::PatchPlan {
        patch: plan.patch,
        tool_axis: vector_msg(&plan.tool_axis),
        feed_direction: vector_msg(&plan.feed_direction),
        pseudo_curvature_max: plan.pseudo_curvature_max,
        sample_count: plan.sample_count,
        step_over_min: plan.step_over[0],
        step_over_max: plan.step_over[1],
        area: plan.area,
        pass_count: plan.pass_count,
    }
}

pub(super) fn plan(msg: &msg::PatchPlan) -> PatchPlan {
    PatchPlan {
        patch: msg.patch,
        tool_axis: vector(&msg.tool_axis),
        feed_direction: vector(&msg.feed_direction),
        pseudo_curvature_max: msg.pseudo_curvature_max,
        sample_count: msg.sample_count,
        step_over: [msg.step_over_min, msg.step_over_max],
        area: msg.area,
        pass_count: msg.pass_count,
    }
}

pub(super) fn check_plan(plan: &PatchPlan) -> Result<(), WireError> {
    let of = |what: &str| format!("patch {}: {what}", plan.patch);
    check::unit_vectors(&of("tool axis"), &[plan.tool_axis])?;
    check::unit_vectors(&of("feed direction"), &[plan.feed_direction])?;
    check::finite(&of("the largest pseudo-curvature"), plan.pseudo_curvature_max)?;
    let [least, largest] = plan.step_over;
    check::not_negative(&of("the least step-over"), least)?;
    check::not_negative(&of("the largest step-over"), largest)?;
    check::expect(least <= largest, &of("the least step-over"), least, &format!("at most {largest}"))?;
    check::not_negative(&of("the area"), plan.area)
}

pub(super) fn hash_plan(hash: &mut ContentHash, plan: &PatchPlan) {
    hash.integer(plan.patch);
    hash.vectors(&[plan.tool_axis, plan.feed_direction]);
    hash.number(plan.pseudo_curvature_max);
    hash.integer(plan.sample_count);
    hash.numbers(&plan.step_over);
    hash.number(plan.area);
    hash.integer(plan.pass_count);
}
