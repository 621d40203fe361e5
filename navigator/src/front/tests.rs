//! Splits and collapses on models of one page.

use metanode::header::Blocking;
use metanode::model::{Model, PageReader};
use metanode::page::Page;

use super::*;
use crate::testing;

#[test]
fn a_vertex_is_a_cache_line_and_a_group_three() {
    assert_eq!((size_of::<Vertex>(), align_of::<Vertex>()), (64, 64));
    assert_eq!((size_of::<Group>(), align_of::<Group>()), (192, 64));
    assert_eq!(VERTEX_BYTES, 106);
}

/// The model of a tree, all in one page.
fn one_page(mesh: testing::Mesh) -> (Model, Page) {
    let tree = mesh.into_tree(5, 3);
    let disk = testing::disk_of(&tree, Blocking::Forest { slot_bytes: 1 << 20, fan_out: 2 });
    let model = Model::open(&disk, "model.vdt".as_ref()).unwrap();
    let mut page = model.empty_page();
    model.read_page(model.root_pages()[0], &[], &mut PageReader::default(), &mut page).unwrap();
    (model, page)
}

/// Everything about a front that splits and collapses may not leave different. Numbers of vertices may differ: leaves do not.
fn state(front: &Front) -> impl PartialEq + use<> {
    let mut triangles: Vec<_> = front
        .triangles()
        .map(|(triangle, corners)| corners.map(|vertex| (front.leaf_at(vertex, triangle), front.interval(vertex))))
        .collect();
    triangles.sort_unstable();
    let vertex = |vertex: u32| {
        let Vertex { span, links, record, .. } = front.vertices[vertex as usize];
        let sphere = front.sphere(vertex);
        (span.start, span.end, span.id, span.moved_by, links.page, record, format!("{sphere:?}"))
    };
    let mut vertices: Vec<_> = front.vertices().map(vertex).collect();
    vertices.sort_unstable();
    (triangles, vertices, front.vanished_trees())
}

/// All splits of a model that fits into one page, down to the leaves, and back: each time what it was before.
#[test]
fn a_collapse_undoes_a_split() {
    let meshes = [testing::Mesh::grid(7, 6, 3), testing::Mesh::sphere(2), testing::Mesh::grid(8, 5, 1).tangled(4)];
    for mesh in meshes.into_iter().chain([testing::Mesh::beside(vec![testing::Mesh::sphere(1); 3])]) {
        let (model, page) = one_page(mesh);
        let header = *model.header();
        let (leaves, triangles) = (header.leaf_count as usize, header.triangle_count as usize);
        let capacity =
            Capacity { vertices: leaves, triangles, lines: 3 * triangles + 10, born_triangles: 100, wedges: 0 };
        let mut front = Front::new(model.roots(), header.leaf_count, capacity);
        let mut random = testing::Random(1);
        let mut log = Vec::new();
        loop {
            let inner: Vec<u32> = front.vertices().filter(|vertex| !front.is_leaf(*vertex)).collect();
            if inner.is_empty() {
                break;
            }
            let vertex = inner[random.below(inner.len())];
            let before = state(&front);
            let prepared = front.prepare(vertex, &page).unwrap();
            assert!(front.has_room(&prepared));
            let born = front.split(&prepared, &page, 0);
            log.push((born, before));
            assert!(front.vertices().all(|vertex| front.criteria_fit(vertex) == Ok(())));
        }
        assert_eq!((front.vertex_count(), front.triangle_count()), (leaves, triangles));
        for (born, before) in log.into_iter().rev() {
            assert!(front.is_collapsible(born));
            front.collapse(born, page.number());
            assert!(state(&front) == before);
            assert!(front.vertices().all(|vertex| front.criteria_fit(vertex) == Ok(())));
        }
        assert_eq!((front.vertex_count(), front.triangle_count(), front.line_count()), (model.roots().len(), 0, 0));
    }
}

/// Triangles and vertices move to the gaps that others leave, and all that names them goes with them.
#[test]
fn gaps_are_closed() {
    let (model, page) = one_page(testing::Mesh::grid(30, 30, 3));
    let header = *model.header();
    let (vertices, triangles) = (header.leaf_count as usize, header.triangle_count as usize);
    let capacity = Capacity { vertices, triangles, lines: 2 * triangles, born_triangles: 100, wedges: 0 };
    let mut front = Front::new(model.roots(), header.leaf_count, capacity);
    let inner = |front: &Front| front.vertices().find(|vertex| !front.is_leaf(*vertex));
    while let Some(vertex) = inner(&front) {
        let prepared = front.prepare(vertex, &page).unwrap();
        front.split(&prepared, &page, 0);
    }
    for _ in 0..vertices / 2 {
        let born = front.born().find(|born| front.is_collapsible(*born)).unwrap();
        front.collapse(born, page.number());
    }
    front.clear_changes();
    let (before, gaps) = (state(&front), front.corners().len() - front.triangle_count());
    front.close_gaps(3);
    let (_, changed) = front.changes();
    assert!(changed.ranges(0).next().is_some());
    front.close_gaps(usize::MAX);
    assert!(state(&front) == before);
    let places = front.vertex_bound() as usize;
    assert!(places - front.vertex_count() <= (places / 8).max(CHUNK));
    let left = front.corners().len() - front.triangle_count();
    assert!(gaps > triangles / 5 && left <= triangles / 8, "{gaps} gaps, {left} left");
    // And it goes on from there, with gaps closed all the way: down to the roots, and to the leaves.
    let whole = |front: &Front| front.vertices().all(|vertex| front.criteria_fit(vertex) == Ok(()));
    let undoable = |front: &Front| front.born().find(|born| front.is_collapsible(*born));
    while let Some(born) = undoable(&front) {
        front.collapse(born, page.number());
        front.close_gaps(2);
        assert!(whole(&front));
    }
    assert_eq!((front.vertex_count(), front.triangle_count(), front.line_count()), (model.roots().len(), 0, 0));
    while let Some(vertex) = inner(&front) {
        let prepared = front.prepare(vertex, &page).unwrap();
        front.split(&prepared, &page, 0);
        front.close_gaps(1);
    }
    assert!(whole(&front));
    assert_eq!((front.vertex_count(), front.triangle_count()), (vertices, triangles));
}
