//! Groups of an HDF5 file with the attributes that NeXus asks for.

use rust_hdf5::dataset::DatasetBuilder;
use rust_hdf5::{DatatypeMessage, H5Dataset, H5File, H5Group, H5Type, Hdf5Error, VarLenUnicode};

/// A group.
pub(in crate::lab) struct Group(H5Group);

impl Group {
    /// Returns the root of a file.
    pub fn root(file: &H5File) -> Self {
        Group(file.root_group())
    }

    /// Returns a group that was made before.
    pub fn existing(&self, name: &str) -> Result<Group, Hdf5Error> {
        self.0.group(name).map(Group)
    }

    /// Makes a group of a NeXus class.
    pub fn group(&self, name: &str, class: &str) -> Result<Group, Hdf5Error> {
        let group = self.0.create_group(name)?;
        group.set_attr_string("NX_class", class)?;
        Ok(Group(group))
    }

    /// Adds an attribute.
    pub fn attribute(&self, name: &str, text: &str) -> Result<(), Hdf5Error> {
        self.0.set_attr_string(name, text)
    }

    /// Adds an attribute with a list of texts.
    pub fn list_attribute(&self, name: &str, texts: &[&str]) -> Result<(), Hdf5Error> {
        self.0.set_attr_string_array(name, texts)
    }

    /// Adds an attribute with a number.
    pub fn number_attribute(&self, name: &str, number: i64) -> Result<(), Hdf5Error> {
        self.0.set_attr_numeric(name, &number)
    }

    /// Adds a link to a place of the file.
    pub fn link(&self, name: &str, to: &str) -> Result<(), Hdf5Error> {
        self.0.create_soft_link(name, to)
    }

    /// Adds a text in UTF-8.
    pub fn text(&self, name: &str, text: &str) -> Result<(), Hdf5Error> {
        // The length of a text is at least 1.
        let bytes = if text.is_empty() {
            b"\0".as_slice()
        } else {
            text.as_bytes()
        };
        let kind = DatatypeMessage::FixedString {
            size: bytes.len() as u32,
            padding: 1,
            charset: 1,
        };
        let place = self.dataset::<u8>().scalar().datatype(kind).create(name)?;
        place.write_raw_bytes(bytes)
    }

    /// Adds texts.
    pub fn texts(&self, name: &str, texts: &[&str]) -> Result<(), Hdf5Error> {
        self.0.write_vlen_strings(name, texts).map(|_| ())
    }

    /// Adds numbers; an empty unit is left out.
    pub fn numbers<T: H5Type>(
        &self,
        name: &str,
        numbers: &[T],
        unit: &str,
    ) -> Result<(), Hdf5Error> {
        let place = self.dataset::<T>().shape([numbers.len()]).create(name)?;
        place.write_raw(numbers)?;
        add_unit(&place, unit)
    }

    /// Adds a number.
    pub fn number(&self, name: &str, number: f64, unit: &str) -> Result<H5Dataset, Hdf5Error> {
        let place = self.dataset::<f64>().scalar().create(name)?;
        place.write_raw(&[number])?;
        add_unit(&place, unit)?;
        Ok(place)
    }

    /// Begins an array.
    pub fn dataset<T: H5Type>(&self) -> DatasetBuilder<T> {
        self.0.new_dataset()
    }
}

fn add_unit(place: &H5Dataset, unit: &str) -> Result<(), Hdf5Error> {
    if unit.is_empty() {
        return Ok(());
    }
    let attribute = place
        .new_attr::<VarLenUnicode>()
        .shape(())
        .create("units")?;
    attribute.write_string(unit)
}
