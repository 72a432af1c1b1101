//! The container of a measured material of the RGL database: named arrays in one file.
//!
//! Little-endian: `tensor_file` and a zero byte, version 1.0, the number of arrays as u32. For each array its name (u16 length
//! and bytes), number of dimensions (u16), type (u8), offset of its data in the file (u64) and lengths of its dimensions (u64
//! each); then the data, the last index fastest.

const MAGIC: &[u8; 12] = b"tensor_file\0";
const VERSION: [u8; 2] = [1, 0];
/// Offsets are multiples of it, since readers map the file and use the numbers in place.
const ALIGNMENT: usize = 8;

/// Type of an array's numbers.
#[derive(Debug, Clone, Copy)]
#[repr(u8)]
enum NumberType {
    UInt8 = 1,
    Float32 = 10,
}

/// An array of the file.
#[derive(Debug, Clone)]
struct Array {
    name: &'static str,
    numbers: NumberType,
    shape: Vec<usize>,
    data: Vec<u8>,
}

/// A file of named arrays.
#[derive(Debug, Clone, Default)]
pub struct TensorFile {
    arrays: Vec<Array>,
}

impl TensorFile {
    /// Adds bytes.
    pub fn add_bytes(&mut self, name: &'static str, bytes: &[u8]) {
        self.arrays.push(Array {
            name,
            numbers: NumberType::UInt8,
            shape: vec![bytes.len()],
            data: bytes.to_vec(),
        });
    }

    /// Adds single-precision numbers; the product of `shape` is their number.
    pub fn add_numbers(&mut self, name: &'static str, shape: &[usize], numbers: &[f32]) {
        debug_assert_eq!(shape.iter().product::<usize>(), numbers.len());
        self.arrays.push(Array {
            name,
            numbers: NumberType::Float32,
            shape: shape.to_vec(),
            data: numbers.iter().flat_map(|x| x.to_le_bytes()).collect(),
        });
    }

    /// Returns the file.
    #[must_use]
    pub fn encode(&self) -> Vec<u8> {
        let start = MAGIC.len() + VERSION.len() + size_of::<u32>();
        let head = |a: &Array| 2 + a.name.len() + 2 + 1 + 8 + 8 * a.shape.len();
        let mut end = start + self.arrays.iter().map(head).sum::<usize>();
        let mut out = Vec::new();
        out.extend(MAGIC);
        out.extend(VERSION);
        out.extend((self.arrays.len() as u32).to_le_bytes());
        for array in &self.arrays {
            end = end.next_multiple_of(ALIGNMENT);
            out.extend((array.name.len() as u16).to_le_bytes());
            out.extend(array.name.as_bytes());
            out.extend((array.shape.len() as u16).to_le_bytes());
            out.push(array.numbers as u8);
            out.extend((end as u64).to_le_bytes());
            for length in &array.shape {
                out.extend((*length as u64).to_le_bytes());
            }
            end += array.data.len();
        }
        out.reserve(end - out.len());
        for array in &self.arrays {
            out.resize(out.len().next_multiple_of(ALIGNMENT), 0);
            out.extend(&array.data);
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_head_names_every_array_and_the_place_of_its_numbers() {
        let mut file = TensorFile::default();
        file.add_bytes("jacobian", &[1]);
        file.add_numbers("ndf", &[1, 2], &[0.5, 2.0]);
        let bytes = file.encode();
        assert_eq!(&bytes[..18], b"tensor_file\0\x01\x00\x02\x00\x00\x00");
        // 18 + 29 + 32 bytes of head; the byte is at 80, the numbers follow at 88.
        assert_eq!(&bytes[18..28], b"\x08\x00jacobian");
        assert_eq!(&bytes[28..31], [1, 0, 1]);
        assert_eq!(bytes[31..39], 80u64.to_le_bytes());
        assert_eq!(bytes[39..47], 1u64.to_le_bytes());
        assert_eq!(&bytes[47..55], b"\x03\x00ndf\x02\x00\x0a");
        assert_eq!(bytes[55..63], 88u64.to_le_bytes());
        assert_eq!(bytes[80], 1);
        assert_eq!(bytes[88..92], 0.5f32.to_le_bytes());
        assert_eq!(bytes[92..], 2.0f32.to_le_bytes());
    }
}
