//! From cut pieces to the passes of a patch: order, senses, links on the surface, lifts between.

use nalgebra::Point3;
use patchmill_products::job::{Job, Pattern, Strategy};
use patchmill_products::toolpath::Pass;
use rayon::prelude::*;

use crate::pass_cut::{Location, PatchCutter};
use crate::piece_order::{Turn, short_order};

/// Longest link cut at feed instead of a lift, m: at 2000 mm/min a lift of 10 mm and back takes as long as about 30 mm.
pub(crate) const LONGEST_LINK: f64 = 15e-3;
/// The same where the least time is asked for, m.
const LONGEST_QUICK_LINK: f64 = 25e-3;

/// A chain of passes over neighbouring planes; each plane's pass may consist of several pieces.
pub type CutChain = Vec<Vec<Vec<Location>>>;

/// The feed polylines of a patch in cutting order, workpiece frame, each with the height of the lift after it.
pub fn linked_passes(cutter: &PatchCutter, chains: Vec<CutChain>, job: &Job) -> Vec<Pass> {
    let link = |from: &Location, to: &Location| cutter.link(from, to);
    let pieces = ordered(chains, job.pattern);
    // Climb milling has an order of its own.
    let mut runs = if job.strategy == Strategy::Fastest && job.pattern != Pattern::Climb {
        merged_runs(&link, in_short_order(pieces, job.pattern), job.pattern, LONGEST_QUICK_LINK)
    } else {
        merged_runs(&link, pieces, job.pattern, LONGEST_LINK)
    };
    let lead = |end: &Location, inward: &Location| cutter.lead(end, inward, job.lead_radius);
    runs.par_iter_mut().for_each(|run| add_leads(run, &lead));
    let back = cutter.frame().inverse();
    let heights: Vec<f64> = (0..runs.len())
        .into_par_iter()
        .map(|i| {
            let end = &runs[i][runs[i].len() - 1].tip;
            let next = runs.get(i + 1).map_or(*end, |run| run[0].tip);
            cutter.highest_between(end, &next) + job.clearance
        })
        .collect();
    runs.into_iter()
        .zip(heights)
        .map(|(run, retract_height)| Pass {
            cl: run.iter().map(|l| back * l.tip).collect(),
            cc: run.iter().map(|l| back * l.contact).collect(),
            tool_axes: Vec::new(),
            retract_height,
        })
        .collect()
}

/// Pieces in an order and sense in which the ways between them are short.
fn in_short_order(mut pieces: Vec<Vec<Location>>, pattern: Pattern) -> Vec<Vec<Location>> {
    let ends: Vec<[Point3<f64>; 2]> =
        pieces.iter().map(|piece| [piece[0].tip, piece[piece.len() - 1].tip]).collect();
    let turned = |(piece, against): Turn| {
        let mut locations = std::mem::take(&mut pieces[piece]);
        if against {
            locations.reverse();
        }
        locations
    };
    short_order(&ends, pattern, LONGEST_QUICK_LINK).into_iter().map(turned).collect()
}

/// Puts lead arcs to both ends of a run; `lead` gives the one over an end and its neighbour, from the run on.
pub(crate) fn add_leads(run: &mut Vec<Location>, lead: &dyn Fn(&Location, &Location) -> Vec<Location>) {
    let [first, second, ..] = run.as_slice() else { return };
    let [.., before, last] = run.as_slice() else { return };
    let (mut entry, exit) = (lead(first, second), lead(last, before));
    entry.reverse();
    run.splice(..0, entry);
    run.extend(exit);
}

/// Pieces in cutting order and sense: greedily the nearest next chain; zigzag alternates the sense from plane to plane, climb
/// milling begins at a chain's leftmost plane, so that what is uncut lies on the right of the feed.
pub(crate) fn ordered(mut chains: Vec<CutChain>, pattern: Pattern) -> Vec<Vec<Location>> {
    chains.iter_mut().for_each(|chain| chain.retain(|pieces| !pieces.is_empty()));
    chains.retain(|chain| !chain.is_empty());
    let mut ordered: Vec<Vec<Location>> = Vec::new();
    while !chains.is_empty() {
        let from = ordered.last().map(|piece| piece[piece.len() - 1].tip);
        // Where a chain may be entered: from its first or last plane, and in zigzag in either sense.
        let senses: &[bool] = if pattern == Pattern::Zigzag { &[false, true] } else { &[false] };
        // In the tool frame the feed is +x, left of it +y.
        let ends: &[bool] = if pattern == Pattern::Climb { &[true] } else { &[false, true] };
        let entries = (0..chains.len()).flat_map(|c| {
            ends.iter().flat_map(move |from_last| senses.iter().map(move |s| (c, *from_last, *s)))
        });
        let distance = |&(c, from_last, against): &(usize, bool, bool)| {
            let pieces = if from_last { &chains[c][chains[c].len() - 1] } else { &chains[c][0] };
            let start = if against {
                let last = &pieces[pieces.len() - 1];
                last[last.len() - 1].tip
            } else {
                pieces[0][0].tip
            };
            from.map_or(0.0, |tip| (start - tip).norm())
        };
        let Some((c, from_last, mut against)) = entries.min_by(|a, b| distance(a).total_cmp(&distance(b)))
        else {
            break;
        };
        let mut chain = chains.remove(c);
        if from_last {
            chain.reverse();
        }
        for mut pieces in chain {
            if against {
                pieces.reverse();
                pieces.iter_mut().for_each(|piece| piece.reverse());
            }
            ordered.extend(pieces);
            against = pattern == Pattern::Zigzag && !against;
        }
    }
    ordered
}

/// Joins consecutive pieces by links on the surface where the pattern and the distance, at most `longest_link` (m), allow it.
pub(crate) fn merged_runs(
    link: &(dyn Fn(&Location, &Location) -> Vec<Location> + Sync),
    pieces: Vec<Vec<Location>>,
    pattern: Pattern,
    longest_link: f64,
) -> Vec<Vec<Location>> {
    let links: Vec<Option<Vec<Location>>> = pieces
        .par_windows(2)
        .map(|pair| {
            let (from, to) = (pair[0][pair[0].len() - 1], pair[1][0]);
            let near = (to.tip - from.tip).norm() <= longest_link;
            (pattern == Pattern::Zigzag && near).then(|| link(&from, &to))
        })
        .collect();
    let mut runs: Vec<Vec<Location>> = Vec::new();
    for (i, piece) in pieces.into_iter().enumerate() {
        match (i.checked_sub(1).and_then(|before| links[before].as_deref()), runs.last_mut()) {
            (Some(link), Some(run)) => {
                // The link begins and ends at the locations of its neighbours.
                run.extend_from_slice(&link[1..link.len() - 1]);
                run.extend(piece);
            }
            _ => runs.push(piece),
        }
    }
    runs
}
