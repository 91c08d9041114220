//! Maps, routes and what stands beside the streets.

use std::collections::{BTreeSet, VecDeque};

use super::super::map::{
    HEADINGS, NODES, STREETS, direction, ends, neighbour, node_m, opposite, street,
};
use super::super::route::MAX_HEADINGS;
use super::*;

fn map(seed: u64) -> Map {
    Map::draw(&mut Generator::from_seed(seed))
}

/// The junctions at both ends of each street of a map, by the middles of junctions alone.
fn streets_of(map: &Map) -> Vec<[usize; 2]> {
    (0..STREETS)
        .filter(|&index| map.has_street(index))
        .map(|index| {
            let (node, heading) = ends(index);
            let ([x, y], [ux, uy]) = (node_m(node), direction(heading));
            let far = [x + BLOCK_M * ux, y + BLOCK_M * uy];
            let other = (0..NODES).find(|&other| node_m(other) == far).unwrap();
            [node, other]
        })
        .collect()
}

#[test]
fn the_numbers_of_streets_are_one_to_one() {
    for index in 0..STREETS {
        let (node, heading) = ends(index);
        assert_eq!(street(node, heading), Some(index));
        let other = neighbour(node, heading).unwrap();
        assert_eq!(street(other, opposite(heading)), Some(index));
    }
    let all = (0..NODES).flat_map(|node| HEADINGS.map(|heading| street(node, heading)));
    assert_eq!(all.flatten().count(), 2 * STREETS);
}

#[test]
fn seeds_give_connected_towns_with_junctions_of_two_three_and_four_streets() {
    let mut towns = BTreeSet::new();
    for seed in 0..200 {
        let map = map(seed);
        let streets = streets_of(&map);
        let degree = |node| streets.iter().flatten().filter(|&&end| end == node).count();
        let degrees: BTreeSet<usize> = (0..NODES).map(degree).collect();
        assert_eq!(degrees, BTreeSet::from([2, 3, 4]), "seed {seed}");
        let mut reached = BTreeSet::from([0]);
        let mut queue = VecDeque::from([0]);
        while let Some(node) = queue.pop_front() {
            for ends in streets.iter().filter(|ends| ends.contains(&node)) {
                let other = ends[0] + ends[1] - node;
                if reached.insert(other) {
                    queue.push_back(other);
                }
            }
        }
        assert_eq!(reached.len(), NODES, "seed {seed}");
        assert!((STREETS - 6..=STREETS - 3).contains(&streets.len()));
        if seed < 40 {
            towns.insert(map.streets);
        }
    }
    assert!(towns.len() >= 35, "{} of 40", towns.len());
}

/// In the file of a seed: what is shown stands beside streets that exist, and not on them.
#[test]
fn buildings_stand_beside_streets_that_exist() {
    let number = |text: &str, name: &str| -> Vec<f64> {
        let begin = text.find(&format!(" {name}=\"")).unwrap() + name.len() + 3;
        let value = text[begin..].split('"').next().unwrap();
        value.split(' ').map(|part| part.parse().unwrap()).collect()
    };
    for seed in 0..6 {
        let (text, map) = (scene_mjcf(seed), map(seed));
        // How far a point is from a street's middle line.
        let away_m = |[a, b]: [usize; 2], [x, y]: [f64; 2]| {
            let ([ax, ay], [bx, by]) = (node_m(a), node_m(b));
            let along = ((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / (BLOCK_M * BLOCK_M);
            let along = along.clamp(0.0, 1.0);
            (x - ax - along * (bx - ax)).hypot(y - ay - along * (by - ay))
        };
        let mut count = 0;
        for line in text.lines().filter(|line| {
            line.starts_with("    <geom class=\"visual\" type=\"box\"") && !line.contains("group=")
        }) {
            let (size, pos) = (number(line, "size"), number(line, "pos"));
            let streets = streets_of(&map);
            let nearest = |point: [f64; 2]| {
                streets.iter().map(|&ends| away_m(ends, point)).fold(f64::INFINITY, f64::min)
            };
            assert!(nearest([pos[0], pos[1]]) < 12.0, "seed {seed}: {line}");
            for (dx, dy) in [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)] {
                let corner = [pos[0] + dx * size[0], pos[1] + dy * size[1]];
                // Beyond kerb and walk.
                assert!(nearest(corner) > 6.5, "seed {seed}: {line}");
            }
            count += 1;
        }
        assert!(count > 60, "seed {seed}: {count} buildings");
    }
}

#[test]
fn a_goal_is_three_junctions_away_or_more_on_streets_of_the_map() {
    for seed in 0..300 {
        let mut generator = Generator::from_seed(seed);
        let map = Map::draw(&mut generator);
        let (from, heading) = traffic::draw_way(&map, &mut generator);
        let route = Route::draw(&map, from, heading, &mut generator);
        assert!((4..=MAX_HEADINGS).contains(&route.len));
        let mut node = from;
        for (i, &heading) in route.headings[..route.len].iter().enumerate() {
            assert!(map.has(node, heading), "seed {seed}");
            assert!(
                i == 0 || heading != opposite(route.headings[i - 1]),
                "seed {seed}: turns back"
            );
            node = neighbour(node, heading).unwrap();
        }
        // No way without turning back is shorter: all ways of that many junctions, one by one.
        let goal = {
            let last = route.last().1;
            (last.from, last.heading)
        };
        let mut ways = BTreeSet::from([(from, heading)]);
        for junctions in 1..route.len {
            ways = ways
                .iter()
                .flat_map(|&(node, heading)| {
                    let via = neighbour(node, heading).unwrap();
                    map.ways_on(via, heading).map(move |out| (via, out)).collect::<Vec<_>>()
                })
                .collect();
            assert_eq!(ways.contains(&goal), junctions == route.len - 1, "seed {seed}");
        }
    }
}

#[test]
fn a_route_is_smooth_and_on_the_road_and_its_places_project_to_themselves() {
    for seed in 0..40 {
        let mut generator = Generator::from_seed(seed);
        let map = Map::draw(&mut generator);
        let (from, heading) = traffic::draw_way(&map, &mut generator);
        let route = Route::draw(&map, from, heading, &mut generator);
        let mut last: Option<Place> = None;
        for k in 0..(route.goal_m() * 4.0) as usize {
            let progress_m = k as f64 / 4.0;
            let place = route.place(progress_m, 0.0);
            if let Some(last) = last {
                let [x, y] = place.position_m;
                let step_m = (x - last.position_m[0]).hypot(y - last.position_m[1]);
                assert!((step_m - 0.25).abs() < 1e-3, "seed {seed}, {progress_m} m: {step_m}");
                let turn = wrap_angle(place.heading_rad - last.heading_rad);
                assert!(turn.abs() < 0.25 / 6.0, "seed {seed}, {progress_m} m: {turn}");
            }
            last = Some(place);
            assert!(map.is_on_road(place.position_m), "seed {seed}, {progress_m} m");
            for aside_m in [-1.5, 0.0, 2.0] {
                let beside = route.place(progress_m, aside_m).position_m;
                let seen = route.project(beside, progress_m + 2.0);
                assert!((seen.progress_m - progress_m).abs() < 0.02, "seed {seed} {progress_m}");
                assert!((seen.offset_m - aside_m).abs() < 1e-6, "seed {seed} {progress_m}");
            }
        }
    }
}

/// Streets, round corners and bends, probed where one knows the answer.
#[test]
fn the_road_ends_at_its_edge_lines() {
    let map = (0..).map(map).find(|map| map.arms(5) == 0b1111).unwrap();
    let [x, y] = node_m(5);
    for (offset, is_road) in [
        ([0.0, 0.0], true),
        ([20.0, 3.4], true),
        ([20.0, 3.6], false),
        // A round corner: the circle about (8, 8) with a radius of 4.5.
        ([4.9, 4.7], true),
        ([4.7, 4.9], true),
        ([5.0, 5.0], false),
        ([3.6, 8.1], false),
    ] {
        assert_eq!(map.is_on_road([x + offset[0], y + offset[1]]), is_road, "{offset:?}");
    }
    // The lower left corner of the grid is a bend about (8, 8) from its middle.
    let [x, y] = node_m(0);
    for (offset, is_road) in
        [([0.0, 0.0], true), ([-0.2, -0.2], false), ([8.0, -3.4], true), ([8.0, -3.6], false)]
    {
        assert_eq!(map.is_on_road([x + offset[0], y + offset[1]]), is_road, "{offset:?}");
    }
    assert!(!map.is_on_road([500.0, 0.0]) && !map.is_on_road([f64::NAN, 0.0]));
}
