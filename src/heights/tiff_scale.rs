//! The scale of a TIFF of heights: resolution tags, and the descriptions of ImageJ and OME.

use tiff::decoder::Decoder;
use tiff::decoder::ifd::Value;
use tiff::tags::Tag;

use super::column_units::known;
use super::text::number;
use crate::wording::significant;

/// Largest spacing that resolution tags state, µm. Below 2540 dots per inch they are those of a screen
/// or a printer, which programs write when they do not know the spacing.
const PITCH_MAX_UM: f64 = 10.0;

/// What a file states about its scale.
#[derive(Debug, Default, PartialEq)]
pub(super) struct TiffScale {
    pub pitch_um: Option<[f64; 2]>,
    pub height_unit_um: Option<f64>,
    /// Where the spacing is stated.
    pub note: Option<String>,
}

/// Reads the scale of the current image.
pub(super) fn of(decoder: &mut Decoder<std::io::Cursor<&[u8]>>) -> TiffScale {
    let text = decoder.get_tag_ascii_string(Tag::ImageDescription);
    let text = text.unwrap_or_default();
    let mut scale = match () {
        () if text.contains("PhysicalSizeX=") => of_ome(&text),
        () if text.starts_with("ImageJ=") => of_imagej(&text, resolution(decoder)),
        () => TiffScale {
            pitch_um: of_tags(decoder),
            ..TiffScale::default()
        },
    };
    scale.note = scale.pitch_um.map(|[u, v]| {
        format!(
            "the TIFF states samples of {} × {} µm; --pitch-um (pitch_um) overrides them",
            significant(u),
            significant(v)
        )
    });
    scale
}

/// Samples per unit along rows and columns.
fn resolution(decoder: &mut Decoder<std::io::Cursor<&[u8]>>) -> Option<[f64; 2]> {
    let mut ratio = |tag| match decoder.find_tag(tag) {
        Ok(Some(Value::Rational(a, b))) => Some(f64::from(a) / f64::from(b)),
        _ => None,
    };
    let both = [ratio(Tag::XResolution)?, ratio(Tag::YResolution)?];
    both.iter()
        .all(|r| *r > 0.0 && r.is_finite())
        .then_some(both)
}

fn of_tags(decoder: &mut Decoder<std::io::Cursor<&[u8]>>) -> Option<[f64; 2]> {
    let unit = decoder.find_tag_unsigned::<u32>(Tag::ResolutionUnit).ok()?;
    let unit_um = match unit {
        // The default of the standard.
        None | Some(2) => 25_400.0,
        Some(3) => 10_000.0,
        Some(_) => return None,
    };
    let pitch_um = resolution(decoder)?.map(|per_unit| unit_um / per_unit);
    pitch_um
        .iter()
        .all(|p| *p <= PITCH_MAX_UM)
        .then_some(pitch_um)
}

/// ImageJ counts its resolution in the unit of its description.
fn of_imagej(text: &str, resolution: Option<[f64; 2]>) -> TiffScale {
    let value = |key: &str| text.lines().find_map(|line| line.strip_prefix(key));
    let unit = value("unit=").and_then(|unit| known(&unit.replace("\\u00B5", "µ")));
    TiffScale {
        pitch_um: unit
            .zip(resolution)
            .map(|(um, resolution)| resolution.map(|per_unit| um / per_unit)),
        height_unit_um: value("vunit=").and_then(known),
        note: None,
    }
}

fn of_ome(text: &str) -> TiffScale {
    let value = |key: &str| {
        let (_, rest) = text.split_once(&format!(" {key}=\""))?;
        rest.split('"').next()
    };
    let size = |key: &str| {
        let unit = value(&format!("{key}Unit")).unwrap_or("µm");
        let unit = unit.replace("&#181;", "µ").replace("&#xB5;", "µ");
        Some(number(value(key)?)? * known(&unit)?).filter(|um| *um > 0.0)
    };
    TiffScale {
        pitch_um: size("PhysicalSizeX")
            .zip(size("PhysicalSizeY"))
            .map(|(u, v)| [u, v]),
        ..TiffScale::default()
    }
}

#[cfg(test)]
mod tests {
    use super::super::read;
    use super::*;
    use tiff::encoder::{Rational, TiffEncoder, colortype};
    use tiff::tags::ResolutionUnit;

    /// Spacing of a map with these resolution tags and description.
    fn pitch(unit: ResolutionUnit, per_unit: u32, description: &str) -> Option<[f64; 2]> {
        let mut file = std::io::Cursor::new(Vec::new());
        let mut encoder = TiffEncoder::new(&mut file).unwrap();
        let mut image = encoder.new_image::<colortype::Gray32Float>(2, 2).unwrap();
        image.resolution(unit, Rational { n: per_unit, d: 1 });
        let tags = image.encoder();
        if !description.is_empty() {
            tags.write_tag(Tag::ImageDescription, description).unwrap();
        }
        image.write_data(&[1.0, 2.0, 3.0, 5.0]).unwrap();
        let map = read("map.tif", &file.into_inner()).unwrap();
        assert_eq!(map.notes.len(), usize::from(map.pitch_um.is_some()));
        map.pitch_um
    }

    #[test]
    fn the_spacing_is_read_from_tags_that_are_not_those_of_a_screen() {
        assert_eq!(pitch(ResolutionUnit::Inch, 50_800, ""), Some([0.5; 2]));
        assert_eq!(
            pitch(ResolutionUnit::Centimeter, 10_000, ""),
            Some([1.0; 2])
        );
        assert_eq!(pitch(ResolutionUnit::Inch, 72, ""), None);
        assert_eq!(pitch(ResolutionUnit::Inch, 1200, ""), None);
        assert_eq!(pitch(ResolutionUnit::None, 50_800, ""), None);
        let imagej = "ImageJ=1.54f\nunit=\\u00B5m\n";
        assert_eq!(pitch(ResolutionUnit::None, 2, imagej), Some([0.5; 2]));
        assert_eq!(pitch(ResolutionUnit::None, 2, "ImageJ=1.54f\n"), None);
        let ome = "<Pixels PhysicalSizeX=\"250\" PhysicalSizeXUnit=\"nm\" PhysicalSizeY=\"0.5\"/>";
        assert_eq!(pitch(ResolutionUnit::Inch, 72, ome), Some([0.25, 0.5]));
    }
}
