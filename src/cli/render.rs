//! `ridged render`: pictures of a board of patches before and after a rotation (the paper's Fig. 2).

mod exr;

use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow};

use super::prediction::Scene;
use super::values::whole;
use super::{CliError, output, output_path};
use crate::colour::srgb;
use crate::model::picture::{Board, Picture};
use crate::model::{Surface, Variant, left_out};
use crate::units::Angle;

/// Renders a checkerboard of orthogonal ridges before and after rotation, side by side.
///
/// The PNG is 8-bit sRGB with the brightest pixel of both pictures at white; the EXR holds linear
/// radiance for lamp irradiance 1 in one channel, Y.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ridged render --out quad.png --exr quad.exr")]
#[command(mut_arg("theta_c_deg", of_one_picture))]
pub struct Args {
    /// PNG to write.
    #[arg(long, value_name = "FILE.png")]
    pub out: PathBuf,
    /// EXR with linear radiances to write, too.
    #[arg(long, value_name = "FILE.exr")]
    pub exr: Option<PathBuf>,
    /// Ridge angle.
    #[arg(long, default_value_t = 5.0, value_name = "DEG")]
    pub theta_r_deg: f64,
    /// Turn between the two pictures.
    #[arg(
        long,
        default_value_t = 90.0,
        value_name = "DEG",
        allow_negative_numbers = true
    )]
    pub turn_deg: f64,
    /// The rig and the surface.
    #[command(flatten)]
    pub scene: Scene,
    /// Pixels along a side of each picture.
    #[arg(long, value_name = "N", default_value_t = 512, value_parser = whole::<u32>(16..=8192))]
    pub pixels: u32,
    /// Patches along a side of the board; with an odd number, a quarter turn swaps bright and dark.
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = whole::<u32>(1..=1000))]
    pub patches: u32,
    /// Side of the board, in mm.
    #[arg(long, default_value_t = 40.0, value_name = "MM")]
    pub size_mm: f64,
    /// Distance of camera and lamp, in mm.
    #[arg(long, default_value_t = 400.0, value_name = "MM")]
    pub distance_mm: f64,
}

/// A table of contrasts has several tilts, a picture only one.
fn of_one_picture(tilts: clap::Arg) -> clap::Arg {
    tilts.num_args(1).default_value("0").help("Camera tilt")
}

/// Runs the command.
///
/// # Errors
/// Bad input for options out of range; no result where a file cannot be written.
pub fn run(args: Args) -> Result<(), CliError> {
    let png = args
        .out
        .extension()
        .is_none_or(|e| e.eq_ignore_ascii_case("png"));
    if !png {
        return Err(CliError::bad_input(anyhow!(
            "--out {}: the picture is a PNG; give it a name that ends in .png",
            args.out.display()
        )));
    }
    if args.exr.as_ref() == Some(&args.out) {
        return Err(CliError::bad_input(anyhow!(
            "--out and --exr are the same file: {}",
            args.out.display()
        )));
    }
    output_path::check_file(&args.out)?;
    args.exr
        .as_deref()
        .map_or(Ok(()), output_path::check_file)?;
    let both = pictures(&args)?;
    let unwritable = |path: &Path| format!("cannot write {}", path.display());
    write_png(&args.out, &both)
        .with_context(|| unwritable(&args.out))
        .map_err(CliError::NoResult)?;
    if let Some(path) = &args.exr {
        std::fs::write(path, exr::encode(&both))
            .with_context(|| unwritable(path))
            .map_err(CliError::NoResult)?;
    }
    let also = args.exr.as_ref().map_or_else(String::new, |path| {
        format!("\n{}: radiances", path.display())
    });
    let out = args.out.display();
    output::write(false, &(), || {
        format!("{out}: the board before and after the turn{also}\n")
    })
}

/// Before and after, side by side.
fn pictures(args: &Args) -> Result<Picture, CliError> {
    let (rig, optics, surface) = args.scene.build(&[args.theta_r_deg])?;
    for (name, value) in [("size-mm", args.size_mm), ("distance-mm", args.distance_mm)] {
        if !(value.is_finite() && value > 0.0) {
            return Err(CliError::bad_input(anyhow!(
                "--{name} {value} is out of range: expected a positive number"
            )));
        }
    }
    if !args.turn_deg.is_finite() {
        return Err(CliError::bad_input(anyhow!("--turn-deg is not finite")));
    }
    let [tilt_deg] = args.scene.theta_c_deg[..] else {
        return Err(CliError::bad_input(anyhow!(
            "--theta-c-deg: a picture has one tilt"
        )));
    };
    let surface = Surface {
        theta_r: args.theta_r_deg.to_radians(),
        ..surface
    };
    let board = Board {
        size_mm: args.size_mm,
        patches: args.patches,
        distance_mm: args.distance_mm,
        field_mm: 1.5 * args.size_mm,
    };
    let pixels = args.pixels as usize;
    let [before, after] = [0.0, args.turn_deg].map(|phi_s_deg| {
        board.render(
            &rig,
            Angle::from_deg(tilt_deg),
            Angle::from_deg(phi_s_deg),
            &surface,
            &optics,
            pixels,
        )
    });
    let mut radiance = Vec::with_capacity(2 * pixels * pixels);
    for (a, b) in before
        .radiance
        .chunks(pixels)
        .zip(after.radiance.chunks(pixels))
    {
        radiance.extend_from_slice(a);
        radiance.extend_from_slice(b);
    }
    Ok(Picture {
        width: 2 * pixels,
        height: pixels,
        radiance,
    })
}

fn write_png(path: &Path, picture: &Picture) -> anyhow::Result<()> {
    let white = picture
        .radiance
        .iter()
        .copied()
        .fold(f32::MIN_POSITIVE, f32::max);
    let bytes: Vec<u8> = picture
        .radiance
        .iter()
        .map(|&x| (srgb(f64::from(x / white)) * 255.0).round() as u8)
        .collect();
    let file = BufWriter::new(File::create(path)?);
    let mut encoder = png::Encoder::new(file, picture.width as u32, picture.height as u32);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Eight);
    // The picture's metadata state what its radiances omit.
    let mut left_out = left_out::of_closed_form(
        Variant::Sawtooth,
        &crate::geometry::Cones::NONE,
        f64::INFINITY,
    );
    left_out.push(left_out::two_bounce_quadrature(None));
    encoder.add_itxt_chunk("left_out".to_owned(), serde_json::to_string(&left_out)?)?;
    let mut writer = encoder.write_header()?;
    writer.write_image_data(&bytes)?;
    writer.finish()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::parsed;

    #[test]
    fn both_pictures_are_side_by_side_in_png_and_exr() {
        let folder = tempfile::tempdir().unwrap();
        let (png, exr) = (folder.path().join("q.png"), folder.path().join("q.exr"));
        let args: Args = parsed(&[
            "--pixels",
            "32",
            "--out",
            png.to_str().unwrap(),
            "--exr",
            exr.to_str().unwrap(),
        ]);
        let both = pictures(&args).unwrap();
        assert_eq!((both.width, both.height), (64, 32));
        // The turned board is the board with bright and dark exchanged.
        // Central patch and its neighbour, in both pictures.
        let at = |x: usize| both.radiance[16 * 64 + x];
        assert!((at(16) > at(20)) != (at(48) > at(52)));
        run(args).unwrap();
        let decoder = png::Decoder::new(std::io::BufReader::new(File::open(&png).unwrap()));
        let read = decoder.read_info().unwrap();
        assert_eq!(read.info().size(), (64, 32));
        let kept = &read.info().utf8_text[0];
        assert!(kept.keyword == "left_out" && kept.get_text().unwrap().contains("third bounce"));
        let bytes = std::fs::read(&exr).unwrap();
        assert_eq!(bytes[..4], [0x76, 0x2f, 0x31, 0x01]);
    }
}
