//! Requests to decide again on the map as it is.

use mirador_core::view_planning::{PlanningConfig, StrategyRegistry, Weights};
use mirador_ipc_schema::messages::ReplanRequest;
use mirador_ipc_schema::text;

/// The settings to decide by: those of the graph with what the request asks for instead.
///
/// # Errors
/// What is wrong with the request, and what would be right.
pub(crate) fn settings(own: &PlanningConfig, request: &ReplanRequest) -> Result<PlanningConfig, String> {
    let [information, quality, zones, cost] = request.weights;
    let or = |asked: f64, own: f64| if asked.is_nan() { own } else { asked };
    let weights = Weights {
        information: or(information, own.weights.information),
        quality: or(quality, own.weights.quality),
        zones: or(zones, own.weights.zones),
        cost: or(cost, own.weights.cost),
    };
    let asked = text::unpack(&request.strategy);
    let strategy = if asked.is_empty() { own.strategy.clone() } else { asked.to_owned() };
    let settings = PlanningConfig { weights, strategy, ..own.clone() };
    settings.validate().map_err(|e| e.to_string())?;
    StrategyRegistry::default().create(&settings.strategy).map_err(|e| e.to_string())?;
    Ok(settings)
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOTHING: ReplanRequest = ReplanRequest { weights: [f64::NAN; 4], cause: 0, reserved: 0, strategy: [0; 40] };

    #[test]
    fn what_is_not_asked_for_stays_as_it_is() {
        let own = PlanningConfig::default();
        assert_eq!(settings(&own, &NOTHING).unwrap(), own);
        let request = ReplanRequest { weights: [0.9, f64::NAN, f64::NAN, f64::NAN], ..NOTHING };
        let asked = settings(&own, &request).unwrap();
        assert_eq!(asked.weights, Weights { information: 0.9, ..own.weights });
        let request = ReplanRequest { strategy: text::pack("frontier"), ..NOTHING };
        assert_eq!(settings(&own, &request).unwrap().strategy, "frontier");
    }

    #[test]
    fn an_unknown_strategy_and_weights_without_sense_are_refused_in_words() {
        let own = PlanningConfig::default();
        let request = ReplanRequest { strategy: text::pack("fronteer"), ..NOTHING };
        assert!(settings(&own, &request).unwrap_err().contains("multi_criteria"));
        let request = ReplanRequest { weights: [-1.0, 0.0, 0.0, 0.1], ..NOTHING };
        assert!(settings(&own, &request).is_err());
    }
}
