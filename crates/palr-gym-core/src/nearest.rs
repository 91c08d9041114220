//! "Did you mean": the known name that is closest to a wrong one.

/// The candidate with the smallest edit distance to `wrong`, if it is close enough to be meant:
/// at most a third of the longer name's length, and at least 2.
///
/// ```
/// use palr_gym_core::nearest::nearest;
/// assert_eq!(nearest("hoper", ["ant", "hopper"]), Some("hopper"));
/// assert_eq!(nearest("pong", ["ant", "hopper"]), None);
/// ```
#[must_use]
pub fn nearest<'a>(wrong: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let wrong = wrong.to_lowercase();
    candidates
        .into_iter()
        .map(|candidate| (edit_distance(&wrong, candidate), candidate))
        .filter(|(distance, candidate)| *distance <= (wrong.len().max(candidate.len()) / 3).max(2))
        .min_by_key(|(distance, _)| *distance)
        .map(|(_, candidate)| candidate)
}

/// Levenshtein's distance, one row of the table at a time.
fn edit_distance(left: &str, right: &str) -> usize {
    let right: Vec<char> = right.chars().collect();
    let mut row: Vec<usize> = (0..=right.len()).collect();
    for (i, a) in left.chars().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, b) in right.iter().enumerate() {
            let substituted = diagonal + usize::from(a != *b);
            diagonal = row[j + 1];
            row[j + 1] = substituted.min(row[j] + 1).min(diagonal + 1);
        }
    }
    row[right.len()]
}
