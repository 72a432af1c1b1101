//! Observations as a file of the BiRD project's universal BRDF format, version 1.0 (JSON).
//!
//! The format asks for facts that ridged does not know (organisation, address, contact). They read `not stated`, for the lab
//! to fill in.

use serde_json::{Value, json};

use crate::observation::ObservationSet;

/// Schema that the file names.
const SCHEMA: &str = "https://raw.githubusercontent.com/BiRD-project/BiRD_view/master/BRDF_JSON_schema/brdf_json_schema_v1.0.json";
/// Stands for a fact that the format asks for and that is not known.
const UNKNOWN: &str = "not stated";
/// Cosine of the incidence below which the lamp grazes the surface and a radiance gives no BRDF.
const COS_MIN: f64 = 1e-6;

/// What a file states beside the observations.
#[derive(Debug, Clone, PartialEq)]
pub struct BirdFacts {
    /// Unique name of the data set, a URI.
    pub id: String,
    /// Time of the measurement, RFC 3339 UTC.
    pub timestamp: String,
    /// Name of the sample.
    pub sample: String,
    /// Wavelength of the lamp, nm.
    pub wavelength_nm: Option<f64>,
    /// Name of the person at the rig.
    pub operator_name: Option<String>,
    /// Name and version of the program.
    pub program: String,
}

/// Why observations are not a BRDF.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum BirdError {
    /// The scale is arbitrary.
    #[error(
        "the scan has no white reference, so its signals have no absolute scale and are not a BRDF; scan with a white \
         reference"
    )]
    Relative,
    /// No observation is left.
    #[error("no observation has the lamp and the camera above the surface, so there is no BRDF")]
    Nothing,
}

/// Returns the file: directions in the sample frame (azimuth from u towards v) and the BRDF with its standard uncertainty.
///
/// # Errors
/// Observations without a white reference, or none with lamp and camera above the surface.
pub fn file(set: &ObservationSet, facts: &BirdFacts) -> Result<Value, BirdError> {
    if set.white_reference.is_none() {
        return Err(BirdError::Relative);
    }
    let mut readings = Readings::default();
    for observation in &set.observations {
        let directions = set.rig.directions(observation.pose);
        let (incident, outgoing) = (directions.incident, directions.outgoing);
        if incident.z < COS_MIN || outgoing.z < COS_MIN {
            continue;
        }
        // The zenith angle is kept below 90°, and the azimuth below 360°, as the format demands.
        readings.theta_i.push(zenith_deg(incident.z));
        readings.phi_i.push(azimuth_deg(incident.x, incident.y));
        readings.theta_r.push(zenith_deg(outgoing.z));
        readings.phi_r.push(azimuth_deg(outgoing.x, outgoing.y));
        // The format has no negative values: such a signal is noise about 0.
        readings
            .brdf
            .push((observation.signal / incident.z).max(0.0));
        let shared = &observation.shared;
        let std = observation
            .sigma
            .hypot(shared.white_reference)
            .hypot(shared.led_drift)
            .hypot(shared.detector);
        readings.u_brdf.push(std / incident.z);
    }
    let n = readings.brdf.len();
    if n == 0 {
        return Err(BirdError::Nothing);
    }
    let angle = |values: Vec<f64>| json!({ "unit": "deg", "values": values });
    let mut data = json!({
        "theta_i": angle(readings.theta_i),
        "phi_i": angle(readings.phi_i),
        "theta_r": angle(readings.theta_r),
        "phi_r": angle(readings.phi_r),
        "polarization_i": { "notation": "sp", "values": vec!["u"; n] },
        "polarization_r": { "notation": "sp", "values": vec!["u"; n] },
        "BRDF": {
            "unit": "1/sr",
            "values": readings.brdf,
            "comments": "Radiance divided by irradiance; stray light is not subtracted. Negative readings are written as 0."
        },
        "uBRDF": {
            "unit": "1/sr",
            "values": readings.u_brdf,
            "comments": "Standard uncertainty (k = 1): noise of the frames, certificate of the white reference, lamp drift and camera"
        },
    });
    if let Some(wavelength) = facts.wavelength_nm {
        data["wavelength_i"] = json!({ "unit": "nm", "values": vec![wavelength; n] });
    }
    Ok(json!({ "metadata": metadata(set, facts), "data": data }))
}

#[derive(Default)]
struct Readings {
    theta_i: Vec<f64>,
    phi_i: Vec<f64>,
    theta_r: Vec<f64>,
    phi_r: Vec<f64>,
    brdf: Vec<f64>,
    u_brdf: Vec<f64>,
}

/// Angles are written to this part of a degree: a zero reads 0.
const ANGLE_DIGITS: f64 = 1e9;

fn rounded_deg(angle_deg: f64) -> f64 {
    // Adding 0 turns −0 into 0.
    (angle_deg * ANGLE_DIGITS).round() / ANGLE_DIGITS + 0.0
}

fn zenith_deg(cos: f64) -> f64 {
    rounded_deg(cos.min(1.0).acos().to_degrees())
}

fn azimuth_deg(x: f64, y: f64) -> f64 {
    let azimuth = rounded_deg(y.atan2(x).to_degrees().rem_euclid(360.0));
    // The remainder of a tiny negative angle rounds to 360.
    if azimuth < 360.0 { azimuth } else { 0.0 }
}

fn metadata(set: &ObservationSet, facts: &BirdFacts) -> Value {
    let region = match &set.region {
        Some(region) => format!(", region {region}"),
        None => String::new(),
    };
    let cones = &set.rig.cones;
    json!({
        "schema": SCHEMA,
        "id": facts.id,
        "type": "BRDF",
        "timestamp": facts.timestamp,
        "provenance": {
            "organization": UNKNOWN,
            "location": { "country": UNKNOWN, "city": UNKNOWN, "street": UNKNOWN, "building_nr": UNKNOWN, "postal_code": UNKNOWN },
            "email": UNKNOWN,
            "contact_person": UNKNOWN,
        },
        "description": format!("Scan of {}{region} with {}", facts.sample, facts.program),
        "method": "measurement",
        // An instrument needs the area of its beam, which ridged does not know; what it knows is in the section at the end.
        "instrumentation": "NA",
        "software": { "name": "ridged", "version": facts.program },
        "sample": {
            "name": facts.sample,
            "type": "micro-structured surface",
            "shape": UNKNOWN,
            "dimensions": {},
            "zero_azimuth_location": "direction u along the ridges, as the rig's azimuth zero states it; the azimuth offset of a fit is not applied",
        },
        "environment": "NA",
        "adhoc_section": {
            "operator_name": facts.operator_name,
            "lamp_to_camera_deg": set.rig.theta_l.deg_for_tables(),
            "lamp_angular_radius_deg": cones.lamp.deg_for_tables(),
            "lens_angular_radius_deg": cones.lens.deg_for_tables(),
        },
    })
}
