//! Looks through the camera before a scan: frames at the present pose that are measured, shown and not stored.
//!
//! The owner of the rig takes the frames, so no motion overlaps them. Any other order to the rig comes first: the preview
//! ends, and its caller may repeat it.

use std::sync::Arc;

use tokio::sync::oneshot;
use tokio_util::sync::CancellationToken;

use super::preview_work::{
    PREVIEW_EXPOSURES_MAX, PREVIEW_TIME_S_MAX, PreviewFrame, PreviewRequest, PreviewView,
    PreviewWork, SUGGESTED_MAX,
};
use super::work::Work;
use crate::bench::CaptureRequest;
use crate::bench::stage::{Stage, StageStatus};
use crate::frame::picture::SIDE_PX_MAX;
use crate::frame::{Frame, FrameKind, Picture};
use crate::lab::request_checks::invalid;
use crate::lab::scans::scan_run::RigContext;
use crate::lab::{Holder, Lab, LabError};
use crate::preview::exposures::{ExposureSearch, Next, Tried};
use crate::preview::figures::Figures;
use crate::preview::{Area, CountScale, defects};
use crate::scan::Rig;
use crate::scan::plan::{EXPOSURE_S_MAX, EXPOSURE_S_MIN};
use crate::store::PageRequest;

/// A frame with its masked pixels, before it is measured.
struct Measured {
    frame: Arc<Frame>,
    picture: Arc<Picture>,
    figures: Figures,
}

impl Lab {
    /// Takes a frame per exposure at the present pose and measures it. Nothing moves and nothing is stored.
    ///
    /// # Errors
    /// [`LabError::Invalid`]; [`LabError::Busy`] while a motion or a scan holds the rig, or if another order to it arrives;
    /// [`LabError::NoLampSwitch`], [`LabError::Lamp`], [`LabError::Camera`], [`LabError::Stage`] or [`LabError::NoRig`].
    pub async fn preview(&self, request: PreviewRequest) -> Result<PreviewView, LabError> {
        let settings = &self.side()?.settings;
        let exposures_s = match &request.exposures_s {
            Some(exposures_s) => exposures_s.clone(),
            None => settings.defaults.exposures_s.clone(),
        };
        check(&exposures_s, &request)?;
        if !request.lamp && settings.lamp_off.is_none() {
            return Err(LabError::NoLampSwitch);
        }
        let (answer, view) = oneshot::channel();
        let work = PreviewWork {
            exposures_s,
            request,
            give_way: CancellationToken::new(),
            answer,
        };
        self.request(Work::Preview(Box::new(work))).await?;
        view.await.map_err(|_| LabError::Stopping)?
    }

    /// Returns the picture of a frame of a recent preview; `None` if it is no longer kept.
    #[must_use]
    pub fn preview_picture(&self, id: u64) -> Option<Arc<Picture>> {
        Some(self.inner.rig.as_ref()?.previews.kept(id)?.1)
    }

    /// Returns the counts of a frame of a recent preview; `None` if they are no longer kept.
    #[must_use]
    pub fn preview_counts(&self, id: u64) -> Option<Arc<Frame>> {
        Some(self.inner.rig.as_ref()?.previews.kept(id)?.0)
    }
}

fn check(exposures_s: &[f64], request: &PreviewRequest) -> Result<(), LabError> {
    let n = exposures_s.len();
    if !(1..=PREVIEW_EXPOSURES_MAX).contains(&n) {
        let problem = format!("has {n} exposures, expected 1 to {PREVIEW_EXPOSURES_MAX}");
        return Err(invalid("exposures_s", problem));
    }
    let range = EXPOSURE_S_MIN..=EXPOSURE_S_MAX;
    if let Some(at) = exposures_s.iter().position(|s| !range.contains(s)) {
        let problem = format!(
            "is {} s, expected {EXPOSURE_S_MIN} to {EXPOSURE_S_MAX} s",
            exposures_s[at]
        );
        return Err(invalid(format!("exposures_s[{at}]"), problem));
    }
    let sum: f64 = exposures_s.iter().sum();
    if sum > PREVIEW_TIME_S_MAX {
        let problem = format!("take {sum} s in all, expected at most {PREVIEW_TIME_S_MAX} s");
        return Err(invalid("exposures_s", problem));
    }
    if let Some(suggest) = request.suggest
        && suggest > SUGGESTED_MAX
    {
        let problem = format!("is {suggest}, expected 0 to {SUGGESTED_MAX} exposures");
        return Err(invalid("suggest", problem));
    }
    Ok(())
}

/// Returns the area to measure in frames of this size.
fn area_of(asked: Option<Area>, frame: &Frame) -> Result<Area, LabError> {
    let (width_px, height_px) = (frame.width_px(), frame.height_px());
    let Some(area) = asked else {
        return Ok(Area {
            left_px: 0,
            top_px: 0,
            width_px,
            height_px,
        });
    };
    let fits = |first: u32, length: u32, all: u32| {
        length > 0 && first.checked_add(length).is_some_and(|end| end <= all)
    };
    match fits(area.left_px, area.width_px, width_px)
        && fits(area.top_px, area.height_px, height_px)
    {
        true => Ok(area),
        false => Err(invalid(
            "area",
            format!(
                "columns {} to {} and rows {} to {} are not a part of the frame, which has {width_px} × {height_px} pixels",
                area.left_px,
                u64::from(area.left_px) + u64::from(area.width_px),
                area.top_px,
                u64::from(area.top_px) + u64::from(area.height_px)
            ),
        )),
    }
}

impl RigContext {
    /// Takes a preview and answers it. Ends early if another order arrives or the caller goes.
    pub(in crate::lab) async fn preview(&self, rig: &mut Rig, stage: &Stage, work: PreviewWork) {
        let PreviewWork {
            exposures_s,
            request,
            give_way,
            mut answer,
        } = work;
        let view = tokio::select! {
            biased;
            () = give_way.cancelled() => Err(LabError::Busy { with: Holder::OtherOrder }),
            () = answer.closed() => Err(LabError::BrokenOff),
            view = self.look(rig, stage, &exposures_s, &request) => view,
        };
        let lamp_off = match request.lamp {
            // It was switched on for these frames only.
            true => self.switch_lamp_off(None).await,
            false => Ok(()),
        };
        if let Err(LabError::Stage(error)) = &view {
            rig.let_go_if_lost(error);
        }
        let view = view.and_then(|view| lamp_off.map(|()| view).map_err(LabError::Lamp));
        answer.send(view).ok();
    }

    async fn look(
        &self,
        rig: &mut Rig,
        stage: &Stage,
        exposures_s: &[f64],
        request: &PreviewRequest,
    ) -> Result<PreviewView, LabError> {
        let lamp = match request.lamp {
            true => &self.settings.runner.lamp_on,
            false => &self.settings.lamp_off,
        };
        if let Some(program) = lamp {
            program.run(b"").await.map_err(LabError::Lamp)?;
        }
        let stages = stage.status().await?;
        let known = self.known_defects().await;
        let scale = self.count_scale();
        let mut area = None;
        let mut frames = Vec::with_capacity(exposures_s.len());
        let mut tried = Vec::with_capacity(exposures_s.len());
        for exposure_s in exposures_s.iter().copied() {
            let (frame, taken_at) = capture(rig, &stages, exposure_s).await?;
            let here = area_of(request.area, &frame)?;
            area = Some(here);
            let measured = measure(frame, here, known.clone(), scale).await?;
            let Measured {
                frame,
                picture,
                figures,
            } = measured;
            tried.push(Tried {
                exposure_s,
                max_dn: figures.max_dn,
            });
            frames.push(PreviewFrame {
                id: self.previews.keep(Arc::clone(&frame), Arc::clone(&picture)),
                exposure_s,
                taken_at,
                size_px: (frame.width_px(), frame.height_px()),
                figures,
                picture,
            });
        }
        let area = area.expect("a checked preview has an exposure");
        let wanted = request
            .suggest
            .unwrap_or(exposures_s.len().min(SUGGESTED_MAX));
        let mut suggestion = None;
        if wanted > 0 {
            let mut search = ExposureSearch::new(scale, tried, wanted);
            suggestion = Some(loop {
                match search.next() {
                    Next::Done(found) => break found,
                    Next::Take(exposure_s) => {
                        let (frame, _) = capture(rig, &stages, exposure_s).await?;
                        let measured = measure(frame, area, known.clone(), scale).await?;
                        search.add(Tried {
                            exposure_s,
                            max_dn: measured.figures.max_dn,
                        });
                    }
                }
            });
        }
        Ok(PreviewView {
            stages,
            lamp: request.lamp,
            area,
            defects_known: known.is_some(),
            frames,
            suggestion,
        })
    }

    fn count_scale(&self) -> CountScale {
        let rules = &self.settings.runner.frame;
        CountScale {
            full_dn: rules.saturation_dn,
            black_dn: rules.black_level_dn,
            gain_dn_per_electron: rules.gain_dn_per_electron,
            read_noise_dn: rules.read_noise_dn,
        }
    }

    /// Returns the defect pixels in the newest dark frames of this rig; `None` if there are none, or they cannot be read.
    async fn known_defects(&self) -> Option<Arc<[bool]>> {
        let store = &self.sink.store;
        let dark = FrameKind::Dark;
        let found = store.usable_calibrations(dark, self.rig_id, &[], &[], "", "9999");
        let calibration = found.await.ok()?.into_iter().next()?;
        if let Some(known) = self.previews.defects(calibration.id) {
            return Some(known);
        }
        let page = PageRequest {
            limit: 1000,
            cursor: None,
        };
        let frames = store
            .frames_of_scan(calibration.scan_id, Some(dark), page)
            .await;
        // Dark current shows most in the longest exposure.
        let longest = frames
            .ok()?
            .items
            .into_iter()
            .filter(|frame| frame.accepted);
        let longest = longest.max_by(|a, b| a.exposure_s.total_cmp(&b.exposure_s))?;
        let (store, scale) = (store.clone(), self.count_scale());
        let read = move || {
            let frame = Frame::from_png(&store.read_png(&longest.sha256).ok()?).ok()?;
            Some(Arc::<[bool]>::from(defects::of_dark(&frame, &scale)))
        };
        let defects = tokio::task::spawn_blocking(read).await.ok()??;
        self.previews
            .keep_defects(calibration.id, Arc::clone(&defects));
        Some(defects)
    }
}

async fn capture(
    rig: &mut Rig,
    stages: &StageStatus,
    exposure_s: f64,
) -> Result<(Frame, time::OffsetDateTime), LabError> {
    let request = CaptureRequest {
        kind: FrameKind::Sample,
        pose: stages.pose(),
        exposure_s,
        repeat: 0,
    };
    let captured = rig.camera.capture(&request).await?;
    Ok((captured.frame, captured.started_utc))
}

/// Measures a frame on a thread that may block.
async fn measure(
    frame: Frame,
    area: Area,
    known: Option<Arc<[bool]>>,
    scale: CountScale,
) -> Result<Measured, LabError> {
    let work = move || {
        let pixels = frame.pixels_dn().len();
        // A camera of another size has other pixels.
        let masked: Arc<[bool]> = match known {
            Some(known) if known.len() == pixels => known,
            _ => defects::isolated(&frame, &scale).into(),
        };
        let figures = Figures::of(&frame, area, &masked, &scale)
            .ok_or_else(|| invalid("area", "has only defect pixels; make it larger"))?;
        let picture = Picture::of(&frame, SIDE_PX_MAX, Some(&masked))
            .map_err(|error| LabError::Camera(error.into()))?;
        Ok(Measured {
            frame: Arc::new(frame),
            picture: Arc::new(picture),
            figures,
        })
    };
    let measured = tokio::task::spawn_blocking(work).await;
    measured.map_err(|_| LabError::Panicked)?
}
