//! What the wedges of all files together refer to: materials, images, the lattice of texture coordinates.
//!
//! The materials of several files follow each other. Images are there once each. Texture coordinates are rounded to steps that
//! the largest of them decides, also of those that no corner has: so the step is known when all files have been read.
//!
//! RAM: the names of materials and files, which are limited for each file, and images that lie in mesh files as text.

use std::collections::{BTreeSet, HashMap};
use std::path::PathBuf;

use crate::mesh::{self, Attributes, ImageSource};
use crate::tree::{Appearance, Image, Material};

/// Takes what the readers of files found.
#[derive(Debug, Default)]
pub(super) struct AppearanceReader {
    appearance: Appearance,
    /// The numbers of the images by their source, and by their name where they are missing.
    images: HashMap<(ImageSource, String), u32>,
    missing_files: BTreeSet<PathBuf>,
    largest_texture: f32,
}

impl AppearanceReader {
    /// How many materials the files before this one have.
    pub fn materials(&self) -> u32 {
        self.appearance.materials.len() as u32
    }

    /// The next texture coordinate: finite.
    #[inline]
    pub fn include_texture(&mut self, [u, v]: [f32; 2]) {
        self.largest_texture = self.largest_texture.max(u.abs()).max(v.abs());
    }

    /// A file was read.
    pub fn end_file(&mut self, attributes: Attributes) {
        let kinds = &mut self.appearance.kinds;
        kinds.normals |= attributes.vertex_normals + attributes.wedge_normals > 0;
        kinds.colours |= attributes.vertex_colours + attributes.face_colours > 0;
        kinds.textures |= attributes.vertex_textures + attributes.wedge_textures > 0;
        kinds.materials |= attributes.face_materials > 0;
        self.missing_files.extend(attributes.missing_files);
        for mesh::Material { name, base_colour, image } in attributes.materials {
            let image = image.map(|image| self.number_of(image));
            self.appearance.materials.push(Material { name, base_colour, image });
        }
    }

    fn number_of(&mut self, mesh::Image { name, source }: mesh::Image) -> u32 {
        let key = if source == ImageSource::Missing { name.clone() } else { String::new() };
        *self.images.entry((source.clone(), key)).or_insert_with(|| {
            self.appearance.images.push(Image { name, source });
            self.appearance.images.len() as u32 - 1
        })
    }

    /// What there is, if the files have any attribute; and the files that are named and not there.
    pub fn finish(self) -> (Option<Appearance>, Vec<PathBuf>) {
        let AppearanceReader { mut appearance, missing_files, largest_texture, .. } = self;
        appearance.texture_exponent = Appearance::texture_exponent_for(largest_texture);
        if !appearance.kinds.materials {
            // No corner refers to them.
            appearance.materials.clear();
            appearance.images.clear();
        }
        ((!appearance.kinds.is_empty()).then_some(appearance), missing_files.into_iter().collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn material(name: &str, image: &str, source: ImageSource) -> mesh::Material {
        let image = Some(mesh::Image { name: image.into(), source });
        mesh::Material { name: name.into(), base_colour: None, image }
    }

    #[test]
    fn images_are_there_once_and_materials_follow_each_other() {
        let file = |name: &str| ImageSource::File(name.into());
        let mut reader = AppearanceReader::default();
        let mut first = Attributes { face_materials: 1, vertex_colours: 1, ..Attributes::default() };
        first.materials = vec![material("a", "x", file("x")), material("b", "y", ImageSource::Missing)];
        first.missing_files = ["y", "b.mtl"].map(PathBuf::from).into();
        let mut second = Attributes { wedge_textures: 1, ..Attributes::default() };
        second.materials = vec![
            material("a", "other", file("x")),
            material("c", "z", ImageSource::Missing),
            material("d", "y", ImageSource::Missing),
        ];
        second.missing_files = ["z", "y"].map(PathBuf::from).into();
        reader.end_file(first);
        assert_eq!(reader.materials(), 2);
        reader.end_file(second);
        reader.include_texture([-3.0, 1.0]);
        reader.include_texture([0.5, 255.5]);
        let (appearance, missing) = reader.finish();
        let appearance = appearance.unwrap();
        let materials: Vec<_> = appearance.materials.iter().map(|m| (m.name.as_str(), m.image)).collect();
        assert_eq!(materials, [("a", Some(0)), ("b", Some(1)), ("a", Some(0)), ("c", Some(2)), ("d", Some(1))]);
        let images: Vec<_> = appearance.images.iter().map(|image| image.name.as_str()).collect();
        assert_eq!(images, ["x", "y", "z"]);
        assert_eq!(missing, ["b.mtl", "y", "z"].map(PathBuf::from));
        assert_eq!(appearance.texture_exponent, -15);
        let kinds = appearance.kinds;
        assert_eq!((kinds.normals, kinds.colours, kinds.textures, kinds.materials), (false, true, true, true));
    }

    #[test]
    fn files_without_attributes_have_no_appearance() {
        let mut reader = AppearanceReader::default();
        reader.end_file(Attributes { materials: vec![material("a", "x", ImageSource::Missing)], ..Default::default() });
        assert_eq!(reader.finish(), (None, Vec::new()));
    }
}
