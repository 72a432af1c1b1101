//! The simulated operator: puts samples on the table and the cap on the lens when a scan asks for it.

use tokio::sync::broadcast::error::RecvError;

use super::camera::SampleHandle;
use super::rig::SimulatedRig;
use super::sample::SimulatedSample;
use super::world::{OnTable, World};
use crate::lab::{Lab, LabError};
use crate::material::Material;
use crate::model::{Surface, Variant};
use crate::scan::runner::ScanCommand;
use crate::scan::{Event, OperatorAction, ScanState};
use crate::store::PageRequest;
use crate::store::samples::{NewSample, SimulatedSurface};
use crate::store::scans::ScanFilter;

/// Name of the path-traced sample that a fresh store gets beside a simulated rig.
pub const TRACED_SAMPLE: &str = "traced polymer";
const MODEL_SAMPLE: &str = "model 15°";

const POLYMER: Material = Material::Dielectric {
    eta: 1.54,
    eta_std: 0.005,
};

impl SimulatedRig {
    /// Adds to a store without samples the two that the simulated rig can show at once.
    ///
    /// # Errors
    /// What the lab says.
    pub async fn add_samples(&self, lab: &Lab) -> Result<(), LabError> {
        if lab.store().newest_sample(None).await?.is_some() {
            return Ok(());
        }
        let model = SimulatedSurface::Model {
            theta_r_deg: 15.0,
            alpha_u: 0.10,
            alpha_v: 0.10,
            rho_d: 0.30,
        };
        for (name, surface) in [
            (MODEL_SAMPLE, model),
            (TRACED_SAMPLE, SimulatedSurface::Traced),
        ] {
            lab.add_sample(&NewSample {
                name: name.into(),
                material: POLYMER,
                note: None,
                simulated: Some(surface),
            })
            .await?;
        }
        Ok(())
    }

    /// Starts the operator: before a scan waits, it does in the world what the scan asks for. With `and_continue` it also
    /// confirms the step; otherwise the scan waits for a person's confirmation. A step that was asked for before the operator
    /// came is done first.
    pub fn operate(&self, lab: &Lab, and_continue: bool) -> tokio::task::JoinHandle<()> {
        let world = std::sync::Arc::clone(&self.world);
        let on_table = self.on_table.clone();
        let lab = lab.clone();
        let calls = lab.operator_calls();
        let mut events = lab.events();
        tokio::spawn(async move {
            for (scan_id, action) in waiting(&lab).await {
                act(&lab, &world, &on_table, scan_id, action).await;
                if and_continue {
                    confirm(&lab, scan_id).await;
                }
            }
            let acting = async {
                let Ok(mut calls) = calls else { return };
                while let Some(call) = calls.recv().await {
                    act(&lab, &world, &on_table, call.scan_id, call.action).await;
                    call.done();
                }
            };
            let continuing = async {
                if !and_continue {
                    return;
                }
                loop {
                    let scan_id = match events.recv().await {
                        Ok(event) => match event.event {
                            Event::Scan {
                                scan_id,
                                operator: Some(_),
                                ..
                            } => scan_id,
                            _ => continue,
                        },
                        Err(RecvError::Lagged(_)) => continue,
                        Err(RecvError::Closed) => return,
                    };
                    confirm(&lab, scan_id).await;
                }
            };
            tokio::join!(acting, continuing);
        })
    }
}

async fn confirm(lab: &Lab, scan_id: i64) {
    if let Err(error) = lab.order(scan_id, ScanCommand::Continue).await {
        tracing::debug!(scan_id, %error, "nothing to continue: {error}");
    }
}

/// Scans that wait for a step now.
async fn waiting(lab: &Lab) -> Vec<(i64, OperatorAction)> {
    let filter = ScanFilter {
        state: Some(ScanState::WaitingForOperator),
        ..ScanFilter::default()
    };
    match lab.store().scans(filter, PageRequest::default()).await {
        Ok(scans) => {
            let steps = scans.items.into_iter();
            steps
                .filter_map(|scan| Some((scan.id, scan.operator?)))
                .collect()
        }
        Err(error) => {
            tracing::warn!(%error, "whether a scan waits is not known: {error}");
            Vec::new()
        }
    }
}

async fn act(
    lab: &Lab,
    world: &World,
    on_table: &SampleHandle,
    scan_id: i64,
    action: OperatorAction,
) {
    match action {
        OperatorAction::CapLens => world.cap_lens(true),
        OperatorAction::PlaceWhiteReference => {
            world.cap_lens(false);
            world.place(OnTable::WhiteReference);
        }
        OperatorAction::PlaceSample => {
            let sample = async {
                let scan = lab.store().scan(scan_id).await?;
                lab.store().sample(scan.sample_id).await
            };
            match sample.await {
                Ok(sample) => on_table.set(painted(sample.simulated, sample.material)),
                Err(error) => tracing::warn!(%error, "the part is not known: {error}"),
            }
            world.cap_lens(false);
            world.place(OnTable::Sample);
        }
    }
}

/// Returns the sample of the store as the simulated camera sees it.
fn painted(surface: Option<SimulatedSurface>, material: Material) -> SimulatedSample {
    match surface {
        None | Some(SimulatedSurface::Traced) => SimulatedSample::polymer_10(),
        Some(SimulatedSurface::Model {
            theta_r_deg,
            alpha_u,
            alpha_v,
            rho_d,
        }) => SimulatedSample::Model {
            variant: Variant::Sawtooth,
            surface: Surface {
                theta_r: theta_r_deg.to_radians(),
                alpha_u,
                alpha_v,
                rho_d,
                amplitude: 1.0,
            },
            material,
        },
    }
}
