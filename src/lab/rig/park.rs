//! Parks the axes and switches the lamp off when a scan has ended and when the daemon ends.

use crate::bench::stage::StageError;
use crate::geometry::Pose;
use crate::lab::scans::scan_run::RigContext;
use crate::program::ProgramError;
use crate::scan::event::{AxisEvent, RigActivity};
use crate::scan::visit::stage_code;
use crate::scan::{Event, Rig};

impl RigContext {
    /// Moves both axes to the place of the settings, if there is one, past the forbidden regions. Nothing moves if an axis
    /// has no reference, if the stages are not connected, or if a person, a stop or a fault of the stages has stopped them
    /// since a person last requested motion. Failures are alarms.
    pub(in crate::lab) async fn park(&self, rig: &mut Rig) {
        let access = rig.access();
        let Some(place) = self.settings.park else {
            return;
        };
        let stops = access.stops();
        let Some(stage) = access.stage() else {
            return;
        };
        // Read first: a later stop cancels the motion, an earlier one shows in the permission or in the count.
        let stops_of_stage = stage.stops();
        if !access.may_move_unasked() || access.stops() != stops {
            return;
        }
        let parked = async {
            if !stage.status().await?.all_homed() {
                tracing::info!("the axes are not parked, since they have no reference");
                return Ok(None);
            }
            self.occupation.send_modify(|now| {
                now.activity = Some(RigActivity::Moving);
                now.clears_up = true;
            });
            self.sink.report(Event::Rig {
                activity: RigActivity::Moving,
                theta_c: AxisEvent::to(place.theta_c),
                phi_s: AxisEvent::to(place.phi_s),
            });
            stage.move_pose_since(place, stops_of_stage).await.map(Some)
        };
        let parked: Result<Option<Pose>, StageError> = parked.await;
        // First: a client that reads this event finds the rig idle.
        self.occupy(None, None);
        let error = match parked {
            Ok(None) => return,
            Ok(Some(at)) => {
                return self.sink.report(Event::Rig {
                    activity: RigActivity::Idle,
                    theta_c: AxisEvent::at(at.theta_c),
                    phi_s: AxisEvent::at(at.phi_s),
                });
            }
            Err(error) => error,
        };
        rig.let_go_if_lost(&error);
        if matches!(error, StageError::Stopped) {
            return;
        }
        access.forbid_unasked_motion();
        self.sink.report(Event::Alarm {
            code: stage_code(&error).into(),
            message: format!("the axes could not be parked: {error}"),
            scan_id: None,
        });
    }

    /// Switches the lamp off, if the settings have a command for it. A failure is an alarm, and is returned.
    pub(in crate::lab) async fn switch_lamp_off(
        &self,
        scan_id: Option<i64>,
    ) -> Result<(), ProgramError> {
        let Some(program) = &self.settings.lamp_off else {
            return Ok(());
        };
        let switched = program.run(b"").await;
        if let Err(error) = &switched {
            self.sink.report(Event::Alarm {
                code: "lamp-failed".into(),
                message: format!(
                    "the lamp could not be switched off: {error}; switch it off by hand"
                ),
                scan_id,
            });
        }
        switched
    }
}
