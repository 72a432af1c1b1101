//! A stack of 16-bit grey frames as one TIFF with a page per frame.
//!
//! All pages have one size, so that the place of each is known before a frame is read: a stack is written front to back, to a
//! file or a socket, with one frame in memory. Pixels are not compressed, since frames are noise. A stack of more than 4 GB is a
//! BigTIFF.

use super::Frame;

/// Bits and bytes of a sample.
const SAMPLE_BITS: u64 = 16;
/// Types of a field.
const ASCII: u16 = 2;
const SHORT: u16 = 3;
const LONG: u16 = 4;
const LONG8: u16 = 16;
/// Fields of a page.
const FIELDS: u64 = 11;
/// Shortest description, which a field of either form cannot hold in itself.
const DESCRIPTION_MIN: usize = 10;

/// Where everything in a stack is.
#[derive(Debug, Clone, PartialEq)]
pub struct TiffStack {
    width_px: u32,
    height_px: u32,
    /// One per page, with the zero at its end and an even length.
    descriptions: Vec<Vec<u8>>,
    /// First byte of each page, and the end of the file.
    starts: Vec<u64>,
    is_big: bool,
}

impl TiffStack {
    /// Lays out a stack with a page for each description.
    #[must_use]
    pub fn new(width_px: u32, height_px: u32, descriptions: &[String]) -> Self {
        let descriptions: Vec<Vec<u8>> = descriptions.iter().map(|text| described(text)).collect();
        let small = TiffStack::laid(width_px, height_px, descriptions.clone(), false);
        match small.bytes() > u64::from(u32::MAX) {
            true => TiffStack::laid(width_px, height_px, descriptions, true),
            false => small,
        }
    }

    fn laid(width_px: u32, height_px: u32, descriptions: Vec<Vec<u8>>, is_big: bool) -> Self {
        let mut stack = TiffStack {
            width_px,
            height_px,
            descriptions,
            starts: Vec::new(),
            is_big,
        };
        let mut next = stack.header().len() as u64;
        for description in &stack.descriptions {
            stack.starts.push(next);
            next += stack.directory_bytes() + description.len() as u64 + stack.pixel_bytes();
        }
        stack.starts.push(next);
        stack
    }

    /// Size of the file.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.starts.last().copied().unwrap_or(0)
    }

    /// Number of pages.
    #[must_use]
    pub fn n_pages(&self) -> usize {
        self.starts.len().saturating_sub(1)
    }

    /// Returns the bytes before the first page.
    #[must_use]
    pub fn header(&self) -> Vec<u8> {
        let mut bytes = b"II".to_vec();
        match self.is_big {
            true => {
                bytes.extend([43u16, 8, 0].iter().flat_map(|word| word.to_le_bytes()));
                bytes.extend(16u64.to_le_bytes());
            }
            false => {
                bytes.extend(42u16.to_le_bytes());
                bytes.extend(8u32.to_le_bytes());
            }
        }
        bytes
    }

    /// Returns the bytes of a page; none if the frame has another size than the stack.
    #[must_use]
    pub fn page(&self, index: usize, frame: &Frame) -> Option<Vec<u8>> {
        if (frame.width_px(), frame.height_px()) != (self.width_px, self.height_px) {
            return None;
        }
        let mut bytes = self.directory(index);
        bytes.extend(&self.descriptions[index]);
        bytes.extend(frame.pixels_dn().iter().flat_map(|dn| dn.to_le_bytes()));
        Some(bytes)
    }

    const fn pixel_bytes(&self) -> u64 {
        self.width_px as u64 * self.height_px as u64 * (SAMPLE_BITS / 8)
    }

    const fn directory_bytes(&self) -> u64 {
        match self.is_big {
            true => 8 + FIELDS * 20 + 8,
            false => 2 + FIELDS * 12 + 4,
        }
    }

    fn directory(&self, index: usize) -> Vec<u8> {
        let description = self.starts[index] + self.directory_bytes();
        let description_bytes = self.descriptions[index].len() as u64;
        let offset = if self.is_big { LONG8 } else { LONG };
        let fields: [(u16, u16, u64, u64); FIELDS as usize] = [
            (256, LONG, 1, u64::from(self.width_px)),
            (257, LONG, 1, u64::from(self.height_px)),
            (258, SHORT, 1, SAMPLE_BITS),
            // Not compressed; zero is black.
            (259, SHORT, 1, 1),
            (262, SHORT, 1, 1),
            (270, ASCII, description_bytes, description),
            (273, offset, 1, description + description_bytes),
            (277, SHORT, 1, 1),
            (278, LONG, 1, u64::from(self.height_px)),
            (279, offset, 1, self.pixel_bytes()),
            // Whole numbers without a sign.
            (339, SHORT, 1, 1),
        ];
        let is_last = index + 1 == self.n_pages();
        let next = if is_last { 0 } else { self.starts[index + 1] };
        let mut bytes = Vec::new();
        let number = |bytes: &mut Vec<u8>, value: u64| match self.is_big {
            true => bytes.extend(value.to_le_bytes()),
            // A stack of this form is shorter than 4 GB.
            false => bytes.extend((value as u32).to_le_bytes()),
        };
        match self.is_big {
            true => bytes.extend(FIELDS.to_le_bytes()),
            false => bytes.extend((FIELDS as u16).to_le_bytes()),
        }
        for (tag, kind, count, value) in fields {
            bytes.extend(tag.to_le_bytes());
            bytes.extend(kind.to_le_bytes());
            number(&mut bytes, count);
            // Little-endian, so that a short value is at the start of its place.
            number(&mut bytes, value);
        }
        number(&mut bytes, next);
        bytes
    }
}

fn described(text: &str) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(text.len() + 2);
    for c in text.chars() {
        match c {
            ' '..='~' => bytes.push(c as u8),
            // A description is ASCII; this is how JSON writes other characters.
            _ => {
                let units = c.encode_utf16(&mut [0; 2]).to_vec();
                bytes.extend(
                    units
                        .iter()
                        .flat_map(|unit| format!("\\u{unit:04x}").into_bytes()),
                );
            }
        }
    }
    // A zero ends the text.
    bytes.push(0);
    while bytes.len() < DESCRIPTION_MIN || bytes.len() % 2 != 0 {
        bytes.push(0);
    }
    bytes
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use tiff::decoder::{Decoder, DecodingResult};
    use tiff::tags::Tag;

    use super::*;

    fn frame(seed: u16) -> Frame {
        let pixels = (0..12u16).map(|i| i.wrapping_mul(5461).wrapping_add(seed));
        Frame::new(4, 3, pixels.collect()).unwrap()
    }

    fn written(stack: &TiffStack, frames: &[Frame]) -> Vec<u8> {
        let mut bytes = stack.header();
        for (index, frame) in frames.iter().enumerate() {
            bytes.extend(stack.page(index, frame).unwrap());
        }
        assert_eq!(bytes.len() as u64, stack.bytes());
        bytes
    }

    #[test]
    fn both_forms_are_read_back_bit_for_bit() {
        let frames = [frame(0), frame(1), frame(65_535)];
        let texts = ["", "pose 2", "{\"file\":\"ü.png\"}"].map(String::from);
        let ascii = ["", "pose 2", "{\"file\":\"\\u00fc.png\"}"];
        let small = TiffStack::new(4, 3, &texts);
        let big = TiffStack::laid(4, 3, small.descriptions.clone(), true);
        for stack in [small, big] {
            let mut decoder = Decoder::new(Cursor::new(written(&stack, &frames))).unwrap();
            for (index, frame) in frames.iter().enumerate() {
                let DecodingResult::U16(pixels) = decoder.read_image().unwrap() else {
                    panic!("the pixels are not 16-bit");
                };
                assert_eq!(pixels, frame.pixels_dn());
                let text = decoder.get_tag_ascii_string(Tag::ImageDescription).unwrap();
                assert_eq!(text.trim_end_matches('\0'), ascii[index]);
                assert_eq!(decoder.more_images(), index + 1 < frames.len());
                if decoder.more_images() {
                    decoder.next_image().unwrap();
                }
            }
        }
    }

    #[test]
    fn a_stack_of_more_than_4_gb_is_a_big_tiff() {
        let stack = TiffStack::new(65_535, 32_767, &["a".to_owned()]);
        assert!(stack.bytes() < 1 << 32 && !stack.is_big);
        let stack = TiffStack::new(65_535, 32_767, &["a".to_owned(), "b".to_owned()]);
        assert!(stack.bytes() > 1 << 32 && stack.is_big);
        assert_eq!(&stack.header()[2..4], &43u16.to_le_bytes());
    }

    #[test]
    fn a_frame_of_another_size_has_no_page() {
        let stack = TiffStack::new(3, 4, &["a".to_owned()]);
        assert_eq!(stack.page(0, &frame(0)), None);
    }
}
