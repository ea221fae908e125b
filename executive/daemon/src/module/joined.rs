//! What a module of several is started with: its own part of the plan, its relay's table, the keys of its links.
//!
//! A module that must wait for its peers starts without them: nothing here, and nothing later, waits for another host.

use std::collections::BTreeMap;
use std::net::SocketAddr;

use bateleur_contract::relay::{ATTRIBUTE, STEPPED};
use bateleur_contract::{Clock, RelayTable};

use super::{Options, RunError};
use bateleur_control::{LINKS_FILE, LinkName};
use bateleur_host::keys::{self, Key};
use bateleur_monitor::event::Event;
use bateleur_monitor::run_order::Play;
use bateleur_plan::{ModuleView, Plan, Protection};

/// The plan as the module runs it. Leaves the relay's table and keys in `options`.
pub(super) fn prepare(plan: Plan, options: &mut Options) -> Result<Plan, RunError> {
    let known = plan.modules.iter().flat_map(|module| &module.addresses).map(|address| address.socket);
    check_addresses(&known.collect::<Vec<_>>(), &options.order.addresses)?;
    if let Some(play) = &options.order.play {
        return played(plan, &options.order.module, play);
    }
    let Some(view) = plan.module(&options.order.module) else { return Ok(plan) };
    let (Some(relay), table) = (plan.relay_of(view.id()), table(&view)?) else { return Ok(plan) };
    let Some(mut table) = table else { return Ok(plan) };
    options.link_keys = read_keys(&view, options)?;
    if options.order.clock() == Clock::Virtual {
        table.transport = STEPPED.to_owned();
    }
    redirect(&mut table, &options.order.addresses);
    let relay = plan[relay].name.clone();
    for link in table.links.iter().filter(|link| !link.authenticated) {
        let text = format!(
            "link {} is not authenticated: anybody on its networks can speak for {}",
            link.name, link.peer
        );
        options.events.tell(&Event::Message { time_s: 0.0, partition: relay.clone(), text });
    }
    let value = serde_json::to_value(&table).map_err(unwritable)?;
    options.order.overrides.entry(relay).or_default().insert(ATTRIBUTE.to_owned(), value);
    write_names(&view, options)?;
    Ok(plan.local(view.id()))
}

/// The plan of a module that a recording drives: without the partitions in whose place that stands, and so without keys.
fn played(plan: Plan, module: &str, play: &Play) -> Result<Plan, RunError> {
    let Some(view) = plan.module(module) else { return Ok(plan) };
    let mut local = plan.local(view.id());
    for name in &play.partitions {
        let own = local.partition(name).filter(|&id| local[id].module == view.id());
        let Some(id) = own else {
            let known: Vec<&str> = view.partitions().map(|id| plan[id].name.as_str()).collect();
            let (name, module, known) = (name.clone(), module.to_owned(), known.join(", "));
            return Err(RunError::NoPartition { name, module, known });
        };
        local.partitions[id.index()].played = true;
    }
    Ok(local)
}

fn table(view: &ModuleView<'_>) -> Result<Option<RelayTable>, RunError> {
    view.plan().relay_table(view.id()).map_err(unwritable)
}

fn unwritable(error: serde_json::Error) -> RunError {
    RunError::Machine { what: "cannot write down the plan".to_owned(), why: error.to_string() }
}

/// What the links are called, beside the logs: whoever reads those knows numbers only.
fn write_names(view: &ModuleView<'_>, options: &Options) -> Result<(), RunError> {
    let names = serde_json::to_vec_pretty(&LinkName::of(view)).map_err(unwritable)?;
    let made = std::fs::create_dir_all(&options.order.output)
        .and_then(|()| std::fs::write(options.order.output.join(LINKS_FILE), names));
    made.map_err(super::machine(format!("cannot write {LINKS_FILE}")))
}

/// The keys of all links of the module, in the order of the table.
fn read_keys(view: &ModuleView<'_>, options: &Options) -> Result<Vec<Key>, RunError> {
    let plan = view.plan();
    if let Some(name) =
        options.order.key_files.keys().find(|name| !plan.links.iter().any(|link| link.name == **name))
    {
        let known = plan.links.iter().map(|link| link.name.as_str()).collect::<Vec<_>>().join(", ");
        return Err(RunError::NoLink { name: name.clone(), known });
    }
    let key = |link: &bateleur_plan::Link| match &link.protection {
        Protection::Unauthenticated => Ok(Key::none()),
        Protection::Key { file } => {
            let path = match options.order.key_files.get(&link.name) {
                Some(other) => other.clone(),
                None => options.order.plan_folder.join(file),
            };
            keys::read(&path).map_err(|error| RunError::Key { link: link.name.clone(), error })
        }
    };
    plan.links_of(view.id()).map(|id| key(&plan[id])).collect()
}

/// One that stands nowhere in the plan is a slip of the pen, and the address that was meant would stay in use.
fn check_addresses(known: &[SocketAddr], others: &BTreeMap<SocketAddr, SocketAddr>) -> Result<(), RunError> {
    match others.keys().find(|planned| !known.contains(planned)) {
        None => Ok(()),
        Some(address) => {
            let list: Vec<String> = known.iter().map(ToString::to_string).collect();
            let known = if list.is_empty() { "none".to_owned() } else { list.join(", ") };
            Err(RunError::NoAddress { address: *address, known })
        }
    }
}

/// Other addresses in place of the plan's: for links that are modelled on one machine.
fn redirect(table: &mut RelayTable, addresses: &BTreeMap<SocketAddr, SocketAddr>) {
    let paths = table.links.iter_mut().flat_map(|link| &mut link.paths);
    for address in paths.flat_map(|path| [&mut path.local, &mut path.remote]) {
        if let Some(other) = addresses.get(address) {
            *address = *other;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn address_that_stands_nowhere_in_the_plan_is_refused_with_those_that_do() {
        let known = ["10.77.0.1:15300", "10.77.0.2:15300"].map(|text| text.parse().unwrap());
        let others =
            |planned: &str| BTreeMap::from([(planned.parse().unwrap(), "127.0.0.1:15300".parse().unwrap())]);
        assert!(check_addresses(&known, &others("10.77.0.2:15300")).is_ok());
        let error = check_addresses(&known, &others("1.2.3.4:5")).unwrap_err().to_string();
        assert!(error.contains("1.2.3.4:5") && error.contains("10.77.0.1:15300, 10.77.0.2"), "{error}");
        let error = check_addresses(&[], &others("1.2.3.4:5")).unwrap_err().to_string();
        assert!(error.contains("it has none"), "{error}");
    }
}
