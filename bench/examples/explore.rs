//! Explorations to compare settings by: `explore WORLD COARSER SEEDS STRATEGY [KEY=VALUE ...]`, where KEY is a field of the
//! planner's settings such as `tour.least_gain` or `weights.cost`, or `entrants` for STRATEGY to run them all. Prints the
//! mean over the seeds. `explore bench CASES` is `mirador bench planning`.

use mirador_bench::exploration::{Exploration, World, coarser, planning_config};
use mirador_bench::planning::{self, PlanningCase, PlanningOptions, entrants};
use mirador_core::simulation::ScannerConfig;
use mirador_core::view_planning::{PlanningConfig, StrategyRegistry};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if let [bench, cases] = arguments.as_slice()
        && bench == "bench"
    {
        let cases = cases.split(',').map(str::parse).collect::<Result<Vec<PlanningCase>, _>>()?;
        let options = PlanningOptions { cases, ..PlanningOptions::default() };
        let report = planning::run(&options, &StrategyRegistry::default(), &mut |line| eprintln!("{line}"))?;
        report.print_table(&mut std::io::stdout())?;
        return Ok(());
    }
    let [world, times, seeds, strategy, keys @ ..] = arguments.as_slice() else {
        return Err("usage: explore WORLD COARSER SEEDS STRATEGY|entrants [KEY=VALUE ...]".into());
    };
    let (world, registry) = (World::named(world)?, StrategyRegistry::default());
    let scanner = coarser(&ScannerConfig::lms111(), times.parse()?);
    let configs: Vec<(String, PlanningConfig)> = if strategy == "entrants" {
        let config = |e: &planning::Entrant| PlanningConfig {
            strategy: e.strategy.clone(),
            weights: e.weights,
            ..planning_config(&scanner)
        };
        entrants(&registry).iter().map(|e| (format!("{} {}", e.strategy, e.weights_name), config(e))).collect()
    } else {
        let config = PlanningConfig { strategy: strategy.clone(), ..planning_config(&scanner) };
        vec![(strategy.clone(), config)]
    };
    for (name, config) in configs {
        let mut table = toml::Table::try_from(&config)?;
        for key in keys {
            let (path, value) = key.split_once('=').ok_or("KEY=VALUE")?;
            set(&mut table, path, value)?;
        }
        let planning: PlanningConfig = table.try_into()?;
        let seeds: u64 = seeds.parse()?;
        let (mut scans, mut metres, mut quality, mut coverage, mut ms) = (0.0, 0.0, 0.0, 0.0, 0.0f64);
        let mut stops = String::new();
        for seed in 1..=seeds {
            let run =
                Exploration { scanner: scanner.clone(), planning: planning.clone(), seed, max_scans: 150, threads: 2 };
            let o = run.run(&world, &registry, &|| false)?;
            let last = o.last();
            scans += o.scans() as f64 / seeds as f64;
            metres += last.metres / seeds as f64;
            quality += last.quality / seeds as f64;
            coverage += last.coverage / seeds as f64;
            ms = o.steps.iter().map(|s| s.planning_ms).fold(ms, f64::max);
            stops += &format!(" {:?}/{}", o.stop, o.scans());
        }
        println!(
            "{:8} {name:32} {} scans {scans:5.1} metres {metres:6.1} quality {quality:.4} coverage {coverage:.4} plan <= {ms:.0} ms {stops}",
            world.name,
            keys.join(" ")
        );
    }
    Ok(())
}

/// Sets a field by its dotted path.
fn set(table: &mut toml::Table, path: &str, value: &str) -> Result<(), Box<dyn std::error::Error>> {
    let (path, last) = path.rsplit_once('.').map_or((None, path), |(path, last)| (Some(path), last));
    let mut inner = table;
    for key in path.into_iter().flat_map(|path| path.split('.')) {
        inner = inner.get_mut(key).and_then(toml::Value::as_table_mut).ok_or_else(|| format!("no table {key}"))?;
    }
    let parsed: toml::Table = format!("v = {value}").parse()?;
    inner.insert(last.to_owned(), parsed["v"].clone());
    Ok(())
}
