//! Promise: the machine of states is the table in its documentation, and what has ended never works again.

use jobs::record::state::{State, Transition, apply};

use Transition as T;

const TRANSITIONS: [T; 7] = [T::Claim, T::Release, T::Orphan, T::Succeed, T::Fail, T::Cancel, T::Expire];

#[test]
fn the_machine_is_the_table() {
    use State::*;
    let table = [
        (Queued, [Some(Running), None, None, None, Some(Failed), Some(Cancelled), Some(Expired)]),
        (Running, [None, Some(Queued), Some(Queued), Some(Succeeded), Some(Failed), Some(Cancelled), Some(Expired)]),
        (Succeeded, [None, None, None, None, None, None, Some(Expired)]),
        (Failed, [None; 7]),
        (Cancelled, [None; 7]),
        (Expired, [None; 7]),
    ];
    assert_eq!(table.map(|(state, _)| state), State::ALL);
    for (state, row) in table {
        assert_eq!(TRANSITIONS.map(|transition| apply(state, transition).ok()), row, "{state:?}");
    }
}

#[test]
fn what_has_ended_stays_ended() {
    for state in State::ALL.into_iter().filter(|state| state.is_ended()) {
        for next in TRANSITIONS.into_iter().filter_map(|transition| apply(state, transition).ok()) {
            assert!(next.is_ended(), "{state:?} becomes {next:?}");
        }
    }
}

#[test]
fn a_refusal_says_what_was_asked() {
    let error = apply(State::Failed, Transition::Claim).unwrap_err();
    assert_eq!(error.to_string(), "a job that is failed cannot be claimed");
}
