//! The engine's init process in a container.

use cotorra_engine::{Engine as _, InstanceId, Outcome, contract::Subject as _};
use cotorra_graph::EngineKind;

use crate::{
    daemon::{next, vnf},
    lab::Lab,
};

fn an_init_process_is_the_first_one(kind: EngineKind) {
    let Some(lab) = Lab::of(kind) else { return };
    let mut engine = lab.engine();
    let mut vnf = vnf(&lab, "[ $$ != 1 ] && echo not first; true");
    let node = lab.nodes()[0].clone();
    for (number, (init, line)) in [(true, "not first\n"), (false, "")].into_iter().enumerate() {
        vnf.image.as_mut().unwrap().init = init;
        vnf.id = format!("init-{init}").parse().unwrap();
        engine.start(InstanceId(number as u64), &vnf, 0, &node).unwrap();
        assert_eq!(next(&lab, &mut engine).outcome, Outcome::Ready);
        assert_eq!(next(&lab, &mut engine).outcome, Outcome::Died("exited with status 0".to_owned()));
        assert_eq!(lab.log(vnf.id.as_str()), format!("--- instance {number} on {node}\n{line}"));
    }
}

#[test]
fn an_init_process_of_podman_is_the_first_one() {
    an_init_process_is_the_first_one(EngineKind::Podman);
}

#[test]
fn an_init_process_of_docker_is_the_first_one() {
    an_init_process_is_the_first_one(EngineKind::Docker);
}
