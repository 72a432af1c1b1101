//! The zip archive of an X3P file: main.xml at the top or in a folder, either kind of slash, upper
//! or lower case.

use std::io::{Cursor, Read};

use md5::{Digest, Md5};
use zip::ZipArchive;

use crate::archive::{self, Bounded};
use crate::wording::hex;

/// An opened archive.
pub(super) struct Archive<'c> {
    archive: ZipArchive<Bounded<Cursor<&'c [u8]>>>,
    /// Index and path of each file, with forward slashes.
    members: Vec<(usize, String)>,
    /// The path before the names of main.xml and its linked files.
    folder: String,
    main: usize,
}

impl<'c> Archive<'c> {
    /// Opens an archive and finds its main.xml.
    pub fn open(content: &'c [u8]) -> Result<Self, String> {
        let archive = archive::open(Cursor::new(content))
            .map_err(|e| format!("an X3P file is a zip archive, but this file is not: {e}"))?;
        let name = |n: usize| archive.name_for_index(n)?.ok().map(|name| plain(&name));
        let members: Vec<(usize, String)> = (0..archive.len())
            .filter_map(|n| Some((n, name(n)?)))
            .filter(|(_, path)| !is_aside(path))
            .collect();
        let depth = |path: &str| path.matches('/').count();
        let mut mains: Vec<&(usize, String)> = members
            .iter()
            .filter(|(_, path)| last_of(path).eq_ignore_ascii_case("main.xml"))
            .collect();
        mains.sort_by_key(|(_, path)| depth(path));
        let (main, folder) = match &mains[..] {
            [] => {
                return Err(
                    "the archive contains no main.xml: it is not an X3P file (ISO 25178-72)"
                        .to_owned(),
                );
            }
            [a, b, ..] if depth(&a.1) == depth(&b.1) => {
                return Err(format!(
                    "the archive contains more than one map ({}, {}): pack each map in a separate file",
                    a.1, b.1
                ));
            }
            [(number, path), ..] => (*number, path[..path.len() - last_of(path).len()].to_owned()),
        };
        Ok(Archive {
            archive,
            members,
            folder,
            main,
        })
    }

    /// Reads main.xml.
    pub fn main(&mut self, limit: u64) -> Result<Vec<u8>, String> {
        self.content(self.main, "main.xml", limit)
    }

    /// Reads a file that main.xml links to.
    pub fn linked(&mut self, link: &str, limit: u64) -> Result<Vec<u8>, String> {
        let number = self.find(link).ok_or_else(|| {
            format!(
                "the archive's member {link}: main.xml links to it, but it is not in the archive"
            )
        })?;
        self.content(number, link, limit)
    }

    /// The index of a linked file: beside main.xml, at the top, or the only one of that name.
    fn find(&self, link: &str) -> Option<usize> {
        let link = plain(&link.replace("%20", " "));
        let beside = format!("{}{link}", self.folder);
        let known = |path: &str| self.members.iter().find(|m| m.1 == path);
        let alike = |path: &str| {
            self.members
                .iter()
                .find(|m| m.1.to_lowercase() == path.to_lowercase())
        };
        let found = known(&beside).or_else(|| known(&link));
        let found = found.or_else(|| alike(&beside)).or_else(|| alike(&link));
        let named = || {
            let mut named = self
                .members
                .iter()
                .filter(|m| last_of(&m.1).eq_ignore_ascii_case(last_of(&link)));
            named.next().filter(|_| named.next().is_none())
        };
        found.or_else(named).map(|m| m.0)
    }

    fn content(&mut self, number: usize, name: &str, limit: u64) -> Result<Vec<u8>, String> {
        let message = |e: &dyn std::fmt::Display| format!("the archive's member {name}: {e}");
        let file = self.archive.by_index(number).map_err(|e| message(&e))?;
        let mut bytes = Vec::new();
        file.take(limit + 1)
            .read_to_end(&mut bytes)
            .map_err(|e| message(&e))?;
        match bytes.len() as u64 > limit {
            true => Err(format!("the archive's member {name} is too large")),
            false => Ok(bytes),
        }
    }

    /// Returns a note if main.xml does not match the checksum beside it.
    pub fn main_note(&mut self, main: &[u8], link: Option<&str>) -> Option<String> {
        /// Largest size of a checksum file, in bytes.
        const LIMIT: u64 = 4096;
        let number = self.find(link.unwrap_or("md5checksum.hex"))?;
        let stated = self.content(number, "md5checksum.hex", LIMIT).ok()?;
        note(
            "main.xml",
            main,
            &String::from_utf8_lossy(&stated),
            "the archive's checksum file",
        )
    }
}

/// Returns a note if a content does not match its checksum; `None` if no checksum, or only zeros,
/// is stated.
pub(super) fn note(name: &str, content: &[u8], stated: &str, by: &str) -> Option<String> {
    let is_digest = |word: &&str| word.len() == 32 && word.chars().all(|c| c.is_ascii_hexdigit());
    let words = stated.split(|c: char| !c.is_ascii_alphanumeric());
    let stated = words.into_iter().find(is_digest)?;
    let is_left_open = stated.chars().all(|c| c == '0');
    let is_same = hex(&Md5::digest(content)).eq_ignore_ascii_case(stated);
    (!is_left_open && !is_same).then(|| {
        format!(
            "{name} does not match the MD5 checksum in {by}: it was changed after the file was written, or \
             belongs to another map; export the file again unless this is intended"
        )
    })
}

/// A path with forward slashes and without a prefix before its first name.
fn plain(path: &str) -> String {
    let path = path.trim().replace('\\', "/");
    let mut rest = path.as_str();
    while let Some(inner) = rest.strip_prefix("./").or_else(|| rest.strip_prefix('/')) {
        rest = inner;
    }
    rest.to_owned()
}

/// Whether a member is a folder or a file of the operating system.
fn is_aside(path: &str) -> bool {
    path.ends_with('/')
        || path
            .split('/')
            .any(|part| part == "__MACOSX" || part.starts_with("._"))
}

fn last_of(path: &str) -> &str {
    path.rsplit('/').next().unwrap_or(path)
}

#[cfg(test)]
mod tests {
    use super::super::read;
    use std::io::Write;

    const XML: &str = r#"<?xml version="1.0" encoding="UTF-8"?>
<p:ISO5436_2 xmlns:p="http://www.opengps.eu/2008/ISO5436_2"><Record1><Axes>
 <CX><AxisType>I</AxisType><Increment>1e-6</Increment></CX><CY><AxisType>I</AxisType><Increment>1e-6</Increment></CY>
 <CZ><AxisType>A</AxisType><DataType>D</DataType></CZ></Axes></Record1>
 <Record2><Creator>Müller</Creator></Record2>
 <Record3><MatrixDimension><SizeX>2</SizeX><SizeY>2</SizeY><SizeZ>1</SizeZ></MatrixDimension>
 <DataLink><PointDataLink>bindata/data.bin</PointDataLink></DataLink></Record3></p:ISO5436_2>"#;

    fn packed(members: &[(&str, &[u8])]) -> Vec<u8> {
        let mut zip = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
        let options = zip::write::SimpleFileOptions::default();
        for (name, content) in members {
            zip.start_file(*name, options).unwrap();
            zip.write_all(content).unwrap();
        }
        zip.finish().unwrap().into_inner()
    }

    fn heights() -> Vec<u8> {
        [1f64, 2.0, 3.0, 4.0].map(f64::to_le_bytes).concat()
    }

    #[test]
    fn an_archive_is_read_in_all_forms_of_packing() {
        let (xml, heights) = (XML.as_bytes(), heights());
        for names in [
            ["main.xml", "bindata/data.bin"],
            ["part 17/main.xml", "part 17/bindata/data.bin"],
            ["part 17\\main.xml", "part 17\\bindata\\data.bin"],
            ["./a/b/Main.XML", "./a/b/BinData/Data.bin"],
            ["/MAIN.XML", "/BINDATA/DATA.BIN"],
            ["a/main.xml", "bindata/data.bin"],
            ["main.xml", "data.bin"],
        ] {
            let aside = [
                ("__MACOSX/a/._main.xml", &b"x"[..]),
                ("a/._main.xml", b"x"),
                ("a/", b""),
            ];
            let members: Vec<_> = [(names[0], xml), (names[1], &heights)]
                .into_iter()
                .chain(aside)
                .collect();
            let map =
                read("a.x3p", &packed(&members)).unwrap_or_else(|why| panic!("{names:?}: {why}"));
            assert_eq!(map.heights, [1.0, 2.0, 3.0, 4.0], "{names:?}");
            assert!(map.notes.is_empty());
        }
        let two = packed(&[("a/main.xml", xml), ("b/main.xml", xml)]);
        assert!(
            read("a.x3p", &two)
                .unwrap_err()
                .contains("a/main.xml, b/main.xml")
        );
        assert!(
            read("a.x3p", &packed(&[("a.xml", xml)]))
                .unwrap_err()
                .contains("no main.xml")
        );
        let lone = packed(&[("main.xml", xml)]);
        assert!(
            read("a.x3p", &lone)
                .unwrap_err()
                .contains("bindata/data.bin")
        );
    }

    #[test]
    fn main_xml_may_be_in_any_encoding() {
        let wide: Vec<u8> = XML.encode_utf16().flat_map(u16::to_le_bytes).collect();
        let marked = [&b"\xff\xfe"[..], &wide].concat();
        let latin: Vec<u8> = XML
            .replace("UTF-8", "ISO-8859-1")
            .chars()
            .map(|c| c as u8)
            .collect();
        let with_mark = format!("\u{feff}{XML}").into_bytes();
        for xml in [wide, marked, latin, with_mark] {
            let file = packed(&[("main.xml", &xml), ("bindata/data.bin", &heights())]);
            assert_eq!(read("a.x3p", &file).unwrap().heights[3], 4.0);
        }
    }

    #[test]
    fn wrong_checksums_are_noted() {
        // `printf abc | md5sum`
        let of_abc = "900150983cd24fb0d6963f7d28e17f72";
        assert_eq!(super::note("a", b"abc", of_abc, "b"), None);
        assert_eq!(
            super::note("a", b"abd", "00000000000000000000000000000000", "b"),
            None
        );
        assert_eq!(super::note("a", b"abd", "", "b"), None);
        let stated = XML.replace(
            "</DataLink>",
            &format!("<MD5ChecksumPointData>{of_abc}</MD5ChecksumPointData></DataLink>"),
        );
        let line = format!("{of_abc} *main.xml");
        let file = packed(&[
            ("main.xml", stated.as_bytes()),
            ("bindata/data.bin", &heights()),
            ("md5checksum.hex", line.as_bytes()),
        ]);
        let map = read("a.x3p", &file).unwrap();
        assert!(map.notes.len() == 2, "{:?}", map.notes);
        assert!(map.notes.iter().all(|note| note.contains("MD5")));
    }
}
