//! The sections of the page after the result: what was measured, with which rig and references, what was left out, and
//! the record to check it by.

use serde_json::Value;

use super::markup::Markup;
use super::{Earlier, MeasurementReport, UsedCalibration};
use crate::fit::FitReport;
use crate::frame::FrameKind;
use crate::material::Material;
use crate::scan::IncidentKind;
use crate::series::FlatFacts;
use crate::wording::{counted, names, percent, utc_words as time};

/// Numbers of a list that are shown one by one.
const LIST_MAX: usize = 24;
/// Rows of incidents that are shown; the JSON has all.
const INCIDENTS_MAX: usize = 40;

/// Part, scan and plan.
pub(super) fn measurement(page: &mut Markup, report: &MeasurementReport) {
    let part = &report.part;
    page.tags("<h2>Part, scan and plan</h2>\n<dl>\n");
    page.entry("Part", |p| {
        p.foreign(&part.name);
        if let Some(id) = part.sample_id {
            p.text(&format!(" (no. {id})"));
        }
        earlier(p, "until", &part.earlier_names);
        p
    });
    page.entry("Material", |p| material(p, &part.material));
    if let Some(note) = &part.note {
        page.entry("Note", |p| p.foreign(note));
    }
    if let Some(scan) = &report.scan {
        page.entry("Scan", |p| {
            let origin = match scan.origin {
                "import" => "an imported series",
                _ => "of this rig",
            };
            p.text(&format!("{}, {origin}, {}", scan.id, scan.state));
            if let Some(reason) = &scan.reason {
                p.text(": ").foreign(reason);
            }
            earlier(p, "assigned until", &scan.earlier_samples);
            p
        });
        for (name, definition) in [
            ("Recipe", &scan.recipe),
            ("Specification", &scan.specification),
        ] {
            if let Some(used) = definition {
                page.entry(name, |p| {
                    p.foreign(&used.name)
                        .text(&format!(", version {}", used.version))
                });
            }
        }
        for (name, text) in [
            ("Lot", &scan.lot),
            ("External number", &scan.external_id),
            ("Operator", &scan.operator_name),
        ] {
            if let Some(text) = text {
                page.entry(name, |p| p.foreign(text));
            }
        }
        page.entry("Started by", |p| p.foreign(&scan.who));
        page.entry("Started", |p| match &scan.started_at {
            Some(at) => p.text(&time(at)),
            None => p.text("imported ").text(&time(&scan.created_at)),
        });
        if let Some(at) = &scan.ended_at {
            page.entry("Ended", |p| p.text(&time(at)));
        }
    }
    let plan = &report.plan;
    page.entry("Tilts θc / °", |p| p.list(&plan.theta_c_deg, LIST_MAX));
    page.entry("Azimuths φs / °", |p| p.list(&plan.phi_s_deg, LIST_MAX));
    page.entry("Poses", |p| {
        let of = match plan.poses.is_empty() {
            true => ", each tilt at each azimuth",
            false => ", stated one by one",
        };
        p.text(&format!("{}{of}", plan.n_poses()))
    });
    page.entry("Exposures / s", |p| p.list(&plan.exposures_s, LIST_MAX));
    page.entry("Frames per pose and exposure", |p| {
        p.text(&plan.repeats.to_string())
    });
    page.entry("Frames used", |p| {
        p.text(&report.fit.result.n_frames_used.to_string());
        let rejected = report.fit.result.rejected_frames.len();
        if rejected > 0 {
            p.text(&format!(", {} left out", counted(rejected, "frame")));
        }
        p
    });
    page.tags("</dl>\n");
}

fn earlier(page: &mut Markup, until: &str, all: &[Earlier]) {
    for one in all {
        page.text("; ")
            .foreign(&one.name)
            .text(&format!(" {until} {}", time(&one.until)));
    }
}

fn material<'p>(page: &'p mut Markup, material: &Material) -> &'p mut Markup {
    let one = |page: &mut Markup, name: &str, value: f64, std: f64| {
        page.text(&format!("{name} = ")).stated(value);
        page.text(" (u = ").stated(std).text(")");
    };
    match *material {
        Material::Dielectric { eta, eta_std } => {
            page.text("transparent, ");
            one(page, "n", eta, eta_std);
        }
        Material::Conductor {
            eta,
            k,
            eta_std,
            k_std,
        } => {
            page.text("metal, ");
            one(page, "n", eta, eta_std);
            page.text(", ");
            one(page, "k", k, k_std);
        }
    }
    page
}

/// Geometry, camera and serial numbers.
pub(super) fn rig(page: &mut Markup, report: &MeasurementReport) {
    let rig = &report.rig;
    let geometry = &rig.geometry;
    page.tags("<h2>Rig</h2>\n<dl>\n");
    for stage in &rig.stages {
        let axis = format!("Stage {}", stage.axis);
        page.entry(&axis, |p| {
            p.text(&format!(
                "serial {}, device {}, firmware ",
                stage.serial, stage.device_id
            ));
            p.foreign(&stage.firmware);
            p
        });
    }
    page.entry("Camera", |p| {
        match &rig.camera_serial {
            Some(serial) => p.text("serial ").foreign(serial).text(", "),
            None => p.text("serial not stated, "),
        };
        p.text(&format!(
            "{} × {} px",
            rig.camera.width_px, rig.camera.height_px
        ));
        p
    });
    page.entry("Camera gain", |p| {
        p.stated(rig.camera.gain_dn_per_electron)
            .text(" DN per electron")
    });
    if let Some([low, high]) = rig.sensor_temperature_c {
        page.entry("Sensor temperature", |p| {
            p.stated(low);
            if high > low {
                p.text(" to ").stated(high);
            }
            p.text(" °C");
            p
        });
    }
    page.entry("Lamp to camera θl", |p| {
        p.stated(geometry.theta_l_deg).text("°")
    });
    let optional = [
        ("Lamp azimuth", Some(geometry.light_azimuth_deg), "°"),
        ("Azimuth zero", Some(geometry.azimuth_zero_deg), "°"),
        ("Wavelength", geometry.wavelength_nm, " nm"),
        (
            "Half angle of the lamp",
            geometry.light_angular_radius_deg,
            "°",
        ),
        (
            "Half angle of the lens",
            geometry.lens_angular_radius_deg,
            "°",
        ),
        ("Distance of the lamp", geometry.light_distance_mm, " mm"),
        ("Radius of the lamp", geometry.light_radius_mm, " mm"),
        ("Distance of the camera", geometry.camera_distance_mm, " mm"),
        ("Radius of the lens", geometry.lens_radius_mm, " mm"),
        ("u of the tilt θc", geometry.theta_c_std_deg, "°"),
        ("u of the azimuth φs", geometry.phi_s_std_deg, "°"),
        ("u of θl", geometry.theta_l_std_deg, "°"),
        ("u of the azimuth zero", geometry.azimuth_zero_std_deg, "°"),
        ("u of the sample's tilt", geometry.sample_wedge_std_deg, "°"),
        ("u of the lamp's drift", geometry.lamp_drift_std, ""),
        ("u of an exposure time", rig.camera.exposure_rel_std, ""),
    ];
    for (term, value, unit) in optional {
        if let Some(value) = value {
            page.entry(term, |p| p.stated(value).text(unit));
        }
    }
    let unstated: Vec<&str> = [
        ("rig.theta_c_std_deg", geometry.theta_c_std_deg),
        ("rig.phi_s_std_deg", geometry.phi_s_std_deg),
        ("rig.theta_l_std_deg", geometry.theta_l_std_deg),
        ("rig.sample_wedge_std_deg", geometry.sample_wedge_std_deg),
        ("rig.lamp_drift_std", geometry.lamp_drift_std),
    ]
    .into_iter()
    .filter_map(|(key, value)| value.is_none().then_some(key))
    .collect();
    if !unstated.is_empty() {
        page.entry("Not stated", |p| p.text(&unstated.join(", ")));
    }
    page.tags("</dl>\n");
}

/// The white reference, dark frames, their ages and the certificate.
pub(super) fn calibrations(page: &mut Markup, report: &MeasurementReport) {
    page.tags("<h2>Calibrations</h2>\n<dl>\n");
    page.entry("White reference", |p| match &report.white_reference {
        Some(flat) => reference(p, flat),
        None => p.text("none: the scale of the signals is arbitrary"),
    });
    page.entry("Certificate", |p| {
        match report
            .white_reference
            .as_ref()
            .and_then(FlatFacts::certificate)
        {
            Some(certificate) => p.foreign(certificate),
            None => p.text("not stated (flat.certificate)"),
        };
        p
    });
    let frames = &report.frames;
    page.entry("White-reference frames", |p| {
        p.text(&frames.of_kind(FrameKind::Flat).to_string())
    });
    page.entry("Dark frames", |p| {
        p.text(&frames.of_kind(FrameKind::Dark).to_string())
    });
    page.tags("</dl>\n");
    if report.calibrations.is_empty() {
        return;
    }
    page.tags("<div class=\"scroll\"><table>\n")
        .header(&[
            "calibration",
            "frames",
            "taken",
            "age at the start",
            "exposures / s",
            "tilts θc / °",
        ])
        .tags("<tbody>\n");
    for kept in &report.calibrations {
        calibration(page, kept);
    }
    page.tags("</tbody></table></div>\n");
}

fn calibration(page: &mut Markup, kept: &UsedCalibration) {
    let kind = match kept.kind {
        FrameKind::Dark => "dark",
        FrameKind::Flat => "white reference",
        FrameKind::Sample => "sample",
    };
    page.tags("<tr>")
        .cell(|p| p.text(&format!("{} {kind}, by scan {}", kept.id, kept.scan_id)))
        .figures(|p| p.text(&kept.n_frames.to_string()))
        .cell(|p| p.text(&time(&kept.created_at)))
        .cell(|p| match kept.age_h {
            Some(age) if age > 0.0 => p.number(age, &format!("{age:.1}")).text(" h"),
            Some(_) => p.text("taken by this scan"),
            None => p.text("–"),
        })
        .cell(|p| p.list(&kept.exposures_s, LIST_MAX))
        .cell(|p| p.list(&kept.theta_c_deg, LIST_MAX))
        .tags("</tr>\n");
}

fn reference<'p>(page: &'p mut Markup, flat: &FlatFacts) -> &'p mut Markup {
    let Some(reflectance) = flat.reflectance else {
        return page.text("its reflectance is not stated: the scale of the signals is arbitrary");
    };
    page.text("reflectance ").stated(reflectance);
    if let Some(std) = flat.reflectance_std {
        page.text(" (u = ").stated(std).text(")");
    }
    page
}

/// What the fit omits, assumes and found.
pub(super) fn left_out(page: &mut Markup, fit: &FitReport) {
    page.tags("<h2>Assumed and left out</h2>\n");
    if !fit.left_out.is_empty() {
        page.tags("<div class=\"scroll\"><table>\n")
            .header(&["left out", "reason", "largest effect, of the peak"])
            .tags("<tbody>\n");
        for omission in &fit.left_out {
            page.tags("<tr>")
                .cell(|p| p.message(&omission.what))
                .cell(|p| p.message(&omission.why))
                .figures(|p| match omission.cost {
                    Some(0.0) => p.text("none"),
                    Some(cost) => p.number(cost, &percent(cost)),
                    None => p.text("unknown"),
                })
                .tags("</tr>\n");
        }
        page.tags("</tbody></table></div>\n");
    }
    let findings = fit.findings.iter().map(|finding| {
        let explains = percent(finding.explains);
        format!("Finding ({explains} of χ²): {}", finding.advice)
    });
    let notes: Vec<String> = findings.chain(fit.notes.iter().cloned()).collect();
    if !notes.is_empty() {
        page.tags("<h3>Findings and notes</h3>\n<ul class=\"note\">\n");
        for note in &notes {
            page.tags("<li>").message(note).tags("</li>\n");
        }
        page.tags("</ul>\n");
    }
    let mut reasons: Vec<(&str, usize)> = Vec::new();
    for frame in &fit.rejected_frames {
        match reasons
            .iter_mut()
            .find(|(reason, _)| *reason == frame.reason)
        {
            Some((_, count)) => *count += 1,
            None => reasons.push((&frame.reason, 1)),
        }
    }
    if !reasons.is_empty() {
        page.tags("<h3>Frames left out</h3>\n<ul class=\"note\">\n");
        for (reason, count) in reasons {
            page.tags("<li>").foreign(reason);
            page.text(&format!(": {}", counted(count, "frame")))
                .tags("</li>\n");
        }
        page.tags("</ul>\n");
    }
}

/// Faults during the scan.
pub(super) fn incidents(page: &mut Markup, report: &MeasurementReport) {
    page.tags("<h2>Faults and recoveries during the scan</h2>\n");
    if report.incidents.is_empty() {
        page.tags("<p>None was recorded.</p>\n");
        return;
    }
    page.tags("<div class=\"scroll\"><table>\n")
        .header(&["time", "", "fault", "what happened"])
        .tags("<tbody>\n");
    for incident in report.incidents.iter().take(INCIDENTS_MAX) {
        page.tags("<tr>")
            .cell(|p| p.text(&time(&incident.at)))
            .cell(|p| {
                p.text(match incident.kind {
                    IncidentKind::Alarm => "alarm",
                    IncidentKind::Recovered => "recovered",
                });
                if incident.attended == Some(true) {
                    p.text(" by a person");
                }
                p
            })
            .cell(|p| p.foreign(&incident.code))
            .cell(|p| {
                p.message(&incident.message);
                if !incident.points.is_empty() {
                    let points = counted(incident.points.len(), "point");
                    p.text(&format!(" ({points} taken again)"));
                }
                p
            })
            .tags("</tr>\n");
    }
    page.tags("</tbody></table></div>\n");
    let more = report.incidents.len().saturating_sub(INCIDENTS_MAX);
    if more > 0 {
        page.tags("<p class=\"note\">")
            .text(&format!("{} more in the JSON form.", counted(more, "row")))
            .tags("</p>\n");
    }
}

/// Programs, request and hashes.
pub(super) fn record(page: &mut Markup, report: &MeasurementReport, sha256: &str) {
    page.tags("<h2>Record</h2>\n<dl>\n");
    if let Some(scan) = &report.scan {
        page.entry("Scan run by", |p| p.foreign(&scan.program));
    }
    let fit = &report.fit;
    page.entry("Fit computed by", |p| {
        p.foreign(&fit.computed_by);
        if let Some(at) = &fit.ended_at {
            p.text(", ").text(&time(at));
        }
        p
    });
    page.entry("Report made by", |p| p.text(&report.program));
    page.entry("Options of the fit", |p| options(p, &fit.request));
    page.tags("</dl>\n<p class=\"note\">SHA-256 of the ")
        .text(&counted(report.frames.count, "frame"))
        .text(" (over the lines of sha256sum, by name; the JSON form lists each): ")
        .tags("<code>")
        .text(&report.frames.sha256)
        .tags(
            "</code></p>\n<p class=\"note\">SHA-256 of this report's JSON form (RFC 8785): <code>",
        )
        .text(sha256)
        .tags(
            "</code>. <code>ridged report --check FILE</code> compares it. Times are in UTC.</p>\n",
        );
}

/// Writes the fields of a request that differ from the defaults, and not those that the report states elsewhere.
fn options<'p>(page: &'p mut Markup, request: &Value) -> &'p mut Markup {
    let fields = request.as_object().into_iter().flatten();
    let stated: Vec<String> = fields
        .filter(|(key, value)| {
            let default = match key.as_str() {
                "loss" => *value == "linear",
                "variant" => *value == "auto",
                _ => false,
            };
            let is_empty = value.as_array().is_some_and(Vec::is_empty)
                || value.as_object().is_some_and(serde_json::Map::is_empty);
            let is_off = value.is_null() || **value == Value::Bool(false);
            key.as_str() != "scan_id" && !default && !is_empty && !is_off
        })
        .map(|(key, value)| option(key, value))
        .collect();
    match stated.is_empty() {
        true => page.text("defaults"),
        false => page.foreign(&stated.join(", ")),
    }
}

/// An option of a fit in words.
fn option(key: &str, value: &Value) -> String {
    let named = |key: &str| names::known(key).map_or_else(|| key.to_owned(), |name| name.full());
    let of_each = |words: &dyn Fn(&Value) -> String| {
        let each = value.as_object().into_iter().flatten();
        let each: Vec<String> = each
            .map(|(name, value)| format!("{} = {}", named(name), words(value)))
            .collect();
        each.join(", ")
    };
    let plain = |value: &Value| match value.as_str() {
        Some(text) => text.to_owned(),
        None => value.to_string(),
    };
    match key {
        "fix" => format!("fixed: {}", of_each(&plain)),
        "priors" => {
            let prior = |p: &Value| format!("{} (u = {})", p["value"], p["std"]);
            format!("priors: {}", of_each(&prior))
        }
        "judge" => "model error by the ray tracer".to_owned(),
        "profile" => "profile-likelihood intervals".to_owned(),
        "iterations" => "with the steps of a descent".to_owned(),
        "bootstrap" => format!("bootstrap of {} series", plain(value)),
        "max_seconds" => format!("at most {} s", plain(value)),
        "shape" => format!("measured shape {}", plain(&value["name"])),
        _ => format!("{} {}", key.replace('_', " "), plain(value)),
    }
}
