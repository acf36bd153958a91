//! In what order are views driven to? The shortest open tour from the robot; of many views, the shortest that exchanges find.

use super::cost_tree::{CostTree, Terrain};
use super::survey::Survey;

/// Fine cells along a side of a coarse one: ways between views are measured on ground of this coarseness, 16 times as fast.
const COARSE: usize = 4;

/// The order in which to visit the cells `views` (at least one), starting from the robot and ending anywhere.
pub(super) fn order(survey: &Survey, views: &[usize]) -> Vec<usize> {
    let from_robot: Vec<f64> = views.iter().map(|&at| survey.tree.cost(at).unwrap_or(f64::INFINITY)).collect();
    let between = distances(survey, views);
    shortest_tour(&from_robot, &between)
}

/// The ways between all views [m], over ground that may be a little too free for being coarse; as the crow flies where
/// there is none.
fn distances(survey: &Survey, views: &[usize]) -> Vec<Vec<f64>> {
    let fine = &survey.terrain;
    let rows = fine.slowness.len() / fine.width;
    let (width, height) = (fine.width / COARSE, rows / COARSE);
    let mut coarse =
        Terrain { width, cell_m: fine.cell_m * COARSE as f64, slowness: vec![f32::INFINITY; width * height] };
    for (at, slowness) in fine.slowness.iter().enumerate().filter(|(_, s)| s.is_finite()) {
        let (x, y) = (at % fine.width / COARSE, at / fine.width / COARSE);
        // The rim stays closed; the margin of the window is wider than a coarse cell.
        if x > 0 && y > 0 && x + 1 < width && y + 1 < height {
            let least = &mut coarse.slowness[y * width + x];
            *least = least.min(*slowness);
        }
    }
    let coarse_cell = |at: usize| at / fine.width / COARSE * width + at % fine.width / COARSE;
    let mut tree = CostTree::default();
    let row = |&from: &usize| {
        tree.grow(&coarse, coarse_cell(from));
        let to = |&to: &usize| {
            let ([ax, ay], [bx, by]) = (survey.grid.centre(from), survey.grid.centre(to));
            let straight = (ax - bx).hypot(ay - by);
            tree.cost(coarse_cell(to)).map_or(straight, |way| way.max(straight))
        };
        views.iter().map(to).collect()
    };
    views.iter().map(row).collect()
}

/// Up to so many views every order is weighed.
const FEW: usize = 8;

/// The shortest tour over few views, and a short one over many.
pub(super) fn shortest_tour(from_robot: &[f64], between: &[Vec<f64>]) -> Vec<usize> {
    if from_robot.len() <= FEW { by_subsets(from_robot, between) } else { by_exchanges(from_robot, between) }
}

/// The shortest way over every set of views to each of its members, from smaller sets to larger ones (Held and Karp 1962).
fn by_subsets(from_robot: &[f64], between: &[Vec<f64>]) -> Vec<usize> {
    let count = from_robot.len();
    // By set, one bit a view, and last view: the way, and the view before the last.
    let mut ways = vec![[(f64::INFINITY, usize::MAX); FEW]; 1 << count];
    for set in 1..1_usize << count {
        for last in (0..count).filter(|last| set >> last & 1 == 1) {
            let before = set & !(1 << last);
            let through = |k: usize| (ways[before][k].0 + between[k][last], k);
            let others = (0..count).filter(|k| before >> k & 1 == 1).map(through);
            let shortest = others.min_by(|a, b| a.0.total_cmp(&b.0));
            ways[set][last] = shortest.unwrap_or((from_robot[last], usize::MAX));
        }
    }
    let mut set = (1 << count) - 1;
    let mut last = (0..count).min_by(|&a, &b| ways[set][a].0.total_cmp(&ways[set][b].0));
    let mut tour = Vec::with_capacity(count);
    while let Some(view) = last.filter(|&view| view < count) {
        tour.push(view);
        last = Some(ways[set][view].1);
        set &= !(1 << view);
    }
    tour.reverse();
    tour
}

/// Nearest neighbour first, then pieces are reversed (2-opt) or moved (or-opt) as long as that shortens the way.
fn by_exchanges(from_robot: &[f64], between: &[Vec<f64>]) -> Vec<usize> {
    let count = from_robot.len();
    let mut tour: Vec<usize> = Vec::with_capacity(count);
    while tour.len() < count {
        let way = |to: usize| tour.last().map_or(from_robot[to], |&last| between[last][to]);
        let open = (0..count).filter(|k| !tour.contains(k));
        match open.min_by(|&a, &b| way(a).total_cmp(&way(b))) {
            Some(next) => tour.push(next),
            None => break,
        }
    }
    let length = |tour: &[usize]| {
        let first = tour.first().map_or(0.0, |&first| from_robot[first]);
        first + tour.windows(2).map(|pair| between[pair[0]][pair[1]]).sum::<f64>()
    };
    let mut best = length(&tour);
    // Every round shortens the tour, so it ends; the limit bounds the time of a plan.
    for _ in 0..count {
        let before = best;
        for (first, last) in (0..count).flat_map(|first| (first + 1..count).map(move |last| (first, last))) {
            for change in [reverse, move_first_back, move_last_ahead] {
                let mut changed = tour.clone();
                change(&mut changed[first..=last]);
                let way = length(&changed);
                if way < best - 1e-9 {
                    (tour, best) = (changed, way);
                }
            }
        }
        if best >= before {
            break;
        }
    }
    tour
}

fn reverse(piece: &mut [usize]) {
    piece.reverse();
}

fn move_first_back(piece: &mut [usize]) {
    piece.rotate_left(1);
}

fn move_last_ahead(piece: &mut [usize]) {
    piece.rotate_right(1);
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::SeedableRng;

    fn euclidean(places: &[(f64, f64)]) -> (Vec<f64>, Vec<Vec<f64>>) {
        let apart = |a: &(f64, f64), b: &(f64, f64)| (a.0 - b.0).hypot(a.1 - b.1);
        let from_robot = places.iter().map(|p| apart(p, &(0.0, 0.0))).collect();
        (from_robot, places.iter().map(|a| places.iter().map(|b| apart(a, b)).collect()).collect())
    }

    fn length(tour: &[usize], from_robot: &[f64], between: &[Vec<f64>]) -> f64 {
        from_robot[tour[0]] + tour.windows(2).map(|p| between[p[0]][p[1]]).sum::<f64>()
    }

    fn permutations(count: usize) -> Vec<Vec<usize>> {
        if count == 0 {
            return vec![Vec::new()];
        }
        let shorter = permutations(count - 1);
        let insert = |tour: &Vec<usize>| {
            let tour = tour.clone();
            (0..count).map(move |at| {
                let mut longer = tour.clone();
                longer.insert(at, count - 1);
                longer
            })
        };
        shorter.iter().flat_map(insert).collect()
    }

    proptest! {
        #[test]
        fn a_tour_over_few_views_visits_every_one_once_and_is_the_shortest(
            places in prop::collection::vec((-50.0..50.0f64, -50.0..50.0f64), 1..7),
        ) {
            let (from_robot, between) = euclidean(&places);
            let tour = shortest_tour(&from_robot, &between);
            let mut sorted = tour.clone();
            sorted.sort_unstable();
            prop_assert_eq!(sorted, (0..places.len()).collect::<Vec<_>>());
            let shortest = permutations(places.len())
                .iter()
                .map(|tour| length(tour, &from_robot, &between))
                .fold(f64::INFINITY, f64::min);
            prop_assert!(length(&tour, &from_robot, &between) <= shortest + 1e-9);
        }

        #[test]
        fn a_tour_over_many_views_visits_every_one_once(
            places in prop::collection::vec((-50.0..50.0f64, -50.0..50.0f64), 9..30),
        ) {
            let (from_robot, between) = euclidean(&places);
            let mut tour = shortest_tour(&from_robot, &between);
            tour.sort_unstable();
            prop_assert_eq!(tour, (0..places.len()).collect::<Vec<_>>());
        }
    }

    #[test]
    fn exchanges_find_tours_that_are_longer_than_the_shortest_by_a_fiftieth_on_average() {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let mut coordinate = || f64::from(random.next_u32() % 10_000) / 100.0 - 50.0;
        let ratios = (0..200).map(|_| {
            let places: Vec<_> = (0..FEW).map(|_| (coordinate(), coordinate())).collect();
            let (from_robot, between) = euclidean(&places);
            let way = |tour: &[usize]| length(tour, &from_robot, &between);
            way(&by_exchanges(&from_robot, &between)) / way(&by_subsets(&from_robot, &between))
        });
        let ratios: Vec<f64> = ratios.collect();
        assert!(ratios.iter().all(|ratio| *ratio >= 1.0 - 1e-12));
        let mean = ratios.iter().sum::<f64>() / 200.0;
        assert!(mean < 1.02, "{mean}");
    }

    #[test]
    fn views_on_a_line_are_visited_in_its_order() {
        let (from_robot, between) = euclidean(&[(3.0, 0.0), (1.0, 0.0), (4.0, 0.0), (2.0, 0.0)]);
        assert_eq!(shortest_tour(&from_robot, &between), [1, 3, 0, 2]);
    }
}
