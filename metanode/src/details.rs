//! What only the decoded pages tell of a model: its smallest error, how many triangles are left at some errors, and which
//! fields take how much of the pages.
//!
//! One pass over the pages, all of which are decoded: about a second for a million vertices. RAM: that of a walk, which has a
//! page for each level of the page tree and, for each tree, 4 bytes.

use crate::chain::PageChain;
use crate::codec::FieldBits;
use crate::header::ModelError;
use crate::model::Model;
use crate::walk::walk_along;

/// Figures of a model for which its pages are decoded.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ModelDetails {
    /// The smallest switch value, in mesh units; 0 without splits.
    pub smallest_switch: f32,
    /// Triangles of the uniform cut at each error that was asked for.
    pub triangles: Vec<u64>,
    /// What the coded fields take.
    pub fields: FieldBits,
}

/// Decodes all pages. `errors` are those of the uniform cuts asked for, in mesh units; `progress` is told the part done, from
/// 0 to 1.
pub fn details(model: &Model, errors: &[f32], progress: &mut dyn FnMut(f64)) -> Result<ModelDetails, ModelError> {
    let mut smallest_switch = f32::INFINITY;
    let mut triangles = vec![0; errors.len()];
    let mut chain = PageChain::measuring(model);
    let (mut pages, page_count) = (0_u32, f64::from(model.header().page_count.max(1)));
    walk_along(&mut chain, model, -1.0, |page, switches| {
        for (index, switch) in (0..).zip(switches) {
            smallest_switch = smallest_switch.min(*switch);
            let born = page.triangles(index).len() as u64;
            for (count, _) in triangles.iter_mut().zip(errors).filter(|(_, error)| *switch > **error) {
                *count += born;
            }
        }
        pages += 1;
        progress((f64::from(pages) / page_count).min(1.0));
        Ok::<_, ModelError>(())
    })?;
    let smallest_switch = if pages == 0 { 0.0 } else { smallest_switch };
    Ok(ModelDetails { smallest_switch, triangles, fields: chain.sizes() })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use vdt::tree::Tree;

    use super::*;
    use crate::cut::UniformCut;
    use crate::header::Blocking;
    use crate::statistics::statistics;
    use crate::testing::{blockings, model, plans, random_tree};

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]

        #[test]
        fn details_are_those_of_the_tree(plan in plans(900), blocking in blockings()) {
            let tree = random_tree(&plan);
            let model = model(&tree, blocking);
            let switches: Vec<f32> = tree.splits.iter().map(|split| split.switch).filter(|switch| *switch > 0.0).collect();
            let errors = [0.0, switches[switches.len() / 2], model.header().largest_switch / 2.0, f32::MAX];
            let mut last = 0.0;
            let found = details(&model, &errors, &mut |done| {
                assert!(last <= done && done <= 1.0);
                last = done;
            }).unwrap();
            prop_assert_eq!(last, 1.0);
            prop_assert_eq!(found.smallest_switch, switches.iter().copied().fold(f32::INFINITY, f32::min));
            for (error, triangles) in errors.into_iter().zip(&found.triangles) {
                prop_assert_eq!(UniformCut::new(&model, error).unwrap().triangle_count(), *triangles);
            }
            // The states of a page's coder take 12 bytes. What is at the top of them in the end is rounded by two bytes at most
            // each, and the raw bits are rounded to bytes.
            let statistics = statistics(&model).unwrap();
            let (bytes, pages) = (found.fields.total() / 8.0, statistics.pages as f64);
            let coded = statistics.file.fields as f64;
            prop_assert!(bytes <= coded && bytes >= coded - 13.0 * pages - 1.0, "{} {} {}", bytes, coded, pages);
        }
    }

    #[test]
    fn an_empty_model_has_no_details() {
        let found = details(&model(&Tree::default(), Blocking::default()), &[1.0], &mut |_| ()).unwrap();
        assert_eq!((found.smallest_switch, found.triangles, found.fields.total()), (0.0, vec![0], 0.0));
    }
}
