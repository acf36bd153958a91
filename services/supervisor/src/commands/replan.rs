//! `mirador replan`: another decision on the map that a running graph has.

use std::io::Write;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use mirador_core::view_planning::StrategyRegistry;
use mirador_ipc_schema::messages::{Envelope, Header, ReplanRequest, ViewPlanMeta};
use mirador_ipc_schema::{Participant, Publisher, Sizes, StopSignal, Subscriber, Wake, Wakeable, clock, text, topics};

use super::find::{self, ASKER, Found};
use crate::cli::{Common, ReplanArgs};
use crate::explain::explain_plan;
use crate::{EXIT_DONE, EXIT_FAILED, EXIT_INTERRUPTED, UsageError};

/// How long an answer may take.
const PATIENCE: Duration = Duration::from_secs(10);
/// How often the wish to stop is looked at.
const LOOK: Duration = Duration::from_millis(100);

/// Asks the graph of `--domain`, or the only one that runs, and prints its answer.
///
/// # Errors
/// When the arguments are wrong, or the graph cannot be asked.
pub fn replan(common: &Common, args: &ReplanArgs) -> Result<u8> {
    let request = request(args)?;
    let domain = match find::running(common.domain.as_deref())? {
        Found::Graph(domain) => domain,
        Found::Nothing(message) => {
            eprintln!("{message}");
            return Ok(EXIT_FAILED);
        }
    };
    let stop = StopSignal::from_terminal().context("the signal handlers cannot be installed")?;
    let name = format!("{ASKER}{}", std::process::id());
    let participant = Participant::join(domain, &name, 0, Sizes { scan_points: 1 }, Wake::Event, stop)?;
    let plans: Subscriber<topics::ViewPlan> = participant.subscriber()?;
    let requests: Publisher<topics::ReplanRequests> = participant.publisher()?;
    let asked_ns = clock::monotonic_ns();
    let mut loan = requests.loan(1)?;
    *loan.meta_mut() = Envelope { header: Header::new(0, 0) };
    loan.items_mut().copy_from_slice(&[request]);
    loan.send()?;
    let begin = Instant::now();
    while begin.elapsed() < PATIENCE {
        if participant.stop().is_set() {
            return Ok(EXIT_INTERRUPTED);
        }
        participant.wait(&[&plans as &dyn Wakeable], LOOK);
        while let Some(plan) = plans.receive()? {
            if plan.header().began_ns >= asked_ns && answers(&request, plan.meta()) {
                let mut out = Vec::new();
                explain_plan(Some(plan.meta()), plan.items(), &mut out)?;
                // A reader that closes the pipe early has seen what it wanted.
                let _ = std::io::stdout().lock().write_all(&out);
                return Ok(EXIT_DONE);
            }
        }
    }
    eprintln!(
        "error: no plan came within {} s; planning is not there, has no map yet, or refused (see its log)",
        PATIENCE.as_secs()
    );
    Ok(EXIT_FAILED)
}

fn request(args: &ReplanArgs) -> Result<ReplanRequest> {
    let weights = match args.weights.as_slice() {
        [] => [f64::NAN; 4],
        [a, q, o, c] if args.weights.iter().all(|w| w.is_finite()) => [*a, *q, *o, *c],
        _ => {
            let message = "--weights: give four numbers for information, quality, zones and cost, for example \
                           0.65,0.25,0.1,0.09";
            return Err(UsageError(message.into()).into());
        }
    };
    let mut request = ReplanRequest { weights, ..ReplanRequest::default() };
    if let Some(strategy) = &args.strategy {
        StrategyRegistry::default().create(strategy).map_err(|e| UsageError(format!("--strategy: {e}")))?;
        request.strategy = text::pack(strategy);
    }
    Ok(request)
}

/// Whether a plan was made the way that was asked for: that of a new scan may come first.
fn answers(request: &ReplanRequest, plan: &ViewPlanMeta) -> bool {
    let strategy = text::unpack(&request.strategy);
    let is_by_strategy = strategy.is_empty() || text::unpack(&plan.strategy) == strategy;
    let pairs = request.weights.iter().zip(&plan.weights);
    is_by_strategy && pairs.into_iter().all(|(asked, used)| asked.is_nan() || asked == used)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plan_answers_when_it_was_made_as_asked() {
        let args = ReplanArgs { strategy: Some("frontier".into()), weights: vec![0.5, 0.3, 0.2, 0.1] };
        let request = request(&args).unwrap();
        let plan =
            ViewPlanMeta { strategy: text::pack("frontier"), weights: [0.5, 0.3, 0.2, 0.1], ..ViewPlanMeta::default() };
        assert!(answers(&request, &plan));
        assert!(!answers(&request, &ViewPlanMeta { weights: [0.5, 0.3, 0.2, 0.2], ..plan }));
        assert!(!answers(&request, &ViewPlanMeta { strategy: text::pack("random"), ..plan }));
        let any = self::request(&ReplanArgs { strategy: None, weights: Vec::new() }).unwrap();
        assert!(answers(&any, &plan));
    }

    #[test]
    fn three_weights_are_refused_with_what_would_be_right() {
        let error = request(&ReplanArgs { strategy: None, weights: vec![0.5, 0.3, 0.2] }).unwrap_err();
        assert!(error.to_string().contains("four numbers"), "{error}");
    }
}
