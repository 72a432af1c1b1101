//! A camera with the faults of a plan.

use std::sync::Arc;

use futures::future::BoxFuture;

use super::injector::{CameraFault, FaultInjector};
use crate::bench::{Camera, CameraError, CaptureRequest, Captured};
use crate::frame::Frame;

/// A camera whose frames suffer the faults of a plan.
pub struct FaultyCamera {
    camera: Box<dyn Camera>,
    plan: Arc<FaultInjector>,
    /// The frame that a camera with a ring buffer delivers next.
    buffered: Option<Captured>,
    last: Option<Captured>,
}

impl FaultyCamera {
    /// Adds the faults of a plan to a camera.
    #[must_use]
    pub fn new(camera: Box<dyn Camera>, plan: Arc<FaultInjector>) -> Self {
        FaultyCamera {
            camera,
            plan,
            buffered: None,
            last: None,
        }
    }
}

impl Camera for FaultyCamera {
    fn describe(&self) -> String {
        self.camera.describe()
    }

    fn capture<'a>(
        &'a mut self,
        request: &'a CaptureRequest,
    ) -> BoxFuture<'a, Result<Captured, CameraError>> {
        Box::pin(async move {
            let fault = self.plan.of_frame();
            match fault {
                Some(CameraFault::Fail) => {
                    return Err(CameraError::Failed(
                        "its program ended with exit status 3 (a fault of the plan)".into(),
                    ));
                }
                Some(CameraFault::Hang) => {
                    return Err(CameraError::TimedOut {
                        waited_s: 10.0,
                        hint: "the plan of faults lets the camera hang".into(),
                    });
                }
                _ => {}
            }
            let mut wanted = request.clone();
            if let Some(CameraFault::WrongExposure(factor)) = fault {
                wanted.exposure_s *= factor;
            }
            let mut captured = self.camera.capture(&wanted).await?;
            match fault {
                Some(CameraFault::Repeat) => {
                    if let Some(last) = &self.last {
                        captured = Captured {
                            frame: last.frame.clone(),
                            tag: last.tag.clone(),
                            ..captured
                        };
                    }
                }
                Some(CameraFault::OneBehind) => {
                    let fresh = captured.clone();
                    if let Some(before) = self.buffered.take().or_else(|| self.last.clone()) {
                        captured = Captured {
                            frame: before.frame,
                            tag: before.tag,
                            ..captured
                        };
                    }
                    self.buffered = Some(fresh.clone());
                    self.last = Some(fresh);
                    return Ok(captured);
                }
                Some(CameraFault::Black) => {
                    captured.frame = changed(&captured.frame, |_, dn| dn.min(200))?;
                }
                Some(CameraFault::HalfDark) => {
                    let half = (captured.frame.height_px() / 2) as usize;
                    captured.frame = changed(&captured.frame, |row, dn| match row < half {
                        true => dn,
                        false => dn.min(200),
                    })?;
                }
                Some(CameraFault::Full) => {
                    captured.frame = changed(&captured.frame, |_, _| u16::MAX)?;
                }
                Some(CameraFault::WrongSize) => {
                    captured.frame = Frame::new(2, 2, vec![1000; 4])?;
                }
                _ => {}
            }
            self.buffered = None;
            self.last = Some(captured.clone());
            Ok(captured)
        })
    }
}

/// The frame with another count in each pixel, from its row and its count.
fn changed(
    frame: &Frame,
    mut count: impl FnMut(usize, u16) -> u16,
) -> Result<Frame, crate::frame::FrameError> {
    let width = frame.width_px() as usize;
    let counts = frame.pixels_dn().iter().enumerate();
    let counts = counts.map(|(i, dn)| count(i / width, *dn)).collect();
    Frame::new(frame.width_px(), frame.height_px(), counts)
}
