//! Publishes recorded products as the stages that made them did.

use std::time::Duration;

use patchmill_geometry::mesh::TriangleMesh;
use patchmill_msgs::msg::{Job, PartitionCandidate};
use patchmill_node_runtime::topics::nodes::{
    MACHINE_INTERFACE, PATH_GENERATION, ROLLING_BALL_ANALYSIS, SURFACE_INGESTION, SURFACE_PARTITIONING,
};
use patchmill_node_runtime::{
    JobTag, LargeProduct, Node, ProductServer, Publisher, Qos, RuntimeError, topics,
};
use patchmill_products::field::RollingBallField;
use patchmill_products::samples::SurfaceSamples;
use patchmill_products::toolpath::CandidateToolpath;
use patchmill_products::wire::Provenance;

use super::tolerances::{FIELD, MESH, PARTITION, SAMPLES, TOOLPATH};
use super::{RunProducts, stages_from};

/// For the stages' subscriptions to match; who comes later fetches chunks by the service.
const PATIENCE: Duration = Duration::from_secs(10);

/// Who makes a product and who takes it.
const FLOW: [(&str, &str, &[&str]); 5] = [
    (MESH, SURFACE_INGESTION, &[ROLLING_BALL_ANALYSIS, PATH_GENERATION, MACHINE_INTERFACE]),
    (SAMPLES, SURFACE_INGESTION, &[ROLLING_BALL_ANALYSIS, SURFACE_PARTITIONING, PATH_GENERATION]),
    (FIELD, ROLLING_BALL_ANALYSIS, &[SURFACE_PARTITIONING, PATH_GENERATION]),
    (PARTITION, SURFACE_PARTITIONING, &[PATH_GENERATION]),
    (TOOLPATH, PATH_GENERATION, &[MACHINE_INTERFACE]),
];

/// How many of the stages from `first` on take a product that none of them makes; 0 when it need not be fed.
fn takers(product: &str, first: &str) -> usize {
    let stages = stages_from(first);
    let flow = FLOW.iter().find(|(name, maker, _)| *name == product && !stages.contains(maker));
    flow.map_or(0, |(_, _, takers)| takers.iter().filter(|taker| stages.contains(*taker)).count())
}

/// The publishers of what the stages from one on need.
pub struct Feed {
    first: &'static str,
    job: Publisher<Job>,
    mesh: Option<ProductServer<TriangleMesh>>,
    samples: Option<ProductServer<SurfaceSamples>>,
    field: Option<ProductServer<RollingBallField>>,
    partitions: Option<Publisher<PartitionCandidate>>,
    toolpaths: Option<ProductServer<CandidateToolpath>>,
}

impl Feed {
    /// Offers the topics and services.
    ///
    /// # Errors
    /// As [`Node::publisher`].
    pub fn new(node: &Node, first: &'static str) -> Result<Self, RuntimeError> {
        let partitions = match takers(PARTITION, first) {
            0 => None,
            _ => Some(node.publisher(topics::PARTITION_CANDIDATES, Qos::Product)?),
        };
        Ok(Self {
            first,
            job: node.publisher(topics::JOB, Qos::Status)?,
            mesh: server(node, MESH, first)?,
            samples: server(node, SAMPLES, first)?,
            field: server(node, FIELD, first)?,
            partitions,
            toolpaths: server(node, TOOLPATH, first)?,
        })
    }

    /// What the stages need and the recorded run does not have.
    pub fn lacks(&self, recorded: &RunProducts) -> Vec<String> {
        let count = |all: usize, of: Option<u32>| all > 0 && of.is_none_or(|of| of as usize == all);
        let partitions =
            count(recorded.partitions.len(), recorded.partitions.values().next().map(|p| p.count));
        let toolpaths = count(recorded.toolpaths.len(), recorded.toolpaths.values().next().map(|t| t.count));
        let there = [
            (MESH, recorded.mesh.is_some()),
            (SAMPLES, recorded.samples.is_some()),
            (FIELD, recorded.field.is_some()),
            (PARTITION, partitions),
            (TOOLPATH, toolpaths),
        ];
        let lacking = there.into_iter().filter(|(product, there)| !there && takers(product, self.first) > 0);
        lacking.map(|(product, _)| product.to_owned()).collect()
    }

    /// Publishes the job, as a new run of it, and the recorded products as inputs of that run.
    ///
    /// # Errors
    /// When a product is not valid or cannot be sent.
    pub async fn publish(&self, job: Job, recorded: &RunProducts) -> Result<(), String> {
        let tag = JobTag::of_job(&job);
        let of_job = tag.provenance();
        let of_surface = Provenance::of_surface(tag.stamp.clone(), &tag.surface_id);
        // Whoever matches later is served all the same.
        let readers = stages_from(self.first).iter().filter(|stage| **stage != SURFACE_INGESTION).count();
        let _ = self.job.wait_for_subscriptions(readers, PATIENCE).await;
        self.send(&self.samples, recorded.samples.as_ref(), SAMPLES, &of_surface).await?;
        self.send(&self.mesh, recorded.mesh.as_ref(), MESH, &of_surface).await?;
        self.job.publish(job).map_err(|e| e.to_string())?;
        self.send(&self.field, recorded.field.as_ref(), FIELD, &of_job).await?;
        if let Some(publisher) = &self.partitions {
            let _ = publisher.wait_for_subscriptions(takers(PARTITION, self.first), PATIENCE).await;
            for partition in recorded.partitions.values() {
                let message = partition.to_msg(&of_job).map_err(|e| e.text)?;
                publisher.publish(message).map_err(|e| e.to_string())?;
            }
        }
        for toolpath in recorded.toolpaths.values() {
            self.send(&self.toolpaths, Some(toolpath), TOOLPATH, &of_job).await?;
        }
        Ok(())
    }

    async fn send<P: LargeProduct>(
        &self,
        server: &Option<ProductServer<P>>,
        product: Option<&P>,
        name: &str,
        provenance: &Provenance,
    ) -> Result<(), String> {
        if let (Some(server), Some(product)) = (server, product) {
            let _ = server.wait_for_receivers(takers(name, self.first), PATIENCE).await;
            server.publish(product, provenance).await.map_err(|e| e.text)?;
        }
        Ok(())
    }
}

fn server<P: LargeProduct>(
    node: &Node,
    product: &str,
    first: &str,
) -> Result<Option<ProductServer<P>>, RuntimeError> {
    if takers(product, first) == 0 { Ok(None) } else { ProductServer::new(node).map(Some) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_the_stages_take_and_do_not_make_is_fed() {
        let fed = |first| {
            let all = FLOW.map(|(product, _, _)| (product, takers(product, first)));
            all.into_iter().filter(|(_, takers)| *takers > 0).collect::<Vec<_>>()
        };
        assert!(fed(SURFACE_INGESTION).is_empty());
        assert_eq!(fed(ROLLING_BALL_ANALYSIS), [(MESH, 3), (SAMPLES, 3)]);
        assert_eq!(fed(SURFACE_PARTITIONING), [(MESH, 2), (SAMPLES, 2), (FIELD, 2)]);
        assert_eq!(fed(PATH_GENERATION), [(MESH, 2), (SAMPLES, 1), (FIELD, 1), (PARTITION, 1)]);
        assert_eq!(fed(MACHINE_INTERFACE), [(MESH, 1), (TOOLPATH, 1)]);
    }
}
