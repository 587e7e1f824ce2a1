use proptest::prelude::*;

use super::*;

fn value() -> impl Strategy<Value = Value> {
    let text = "[ -~äß€\t\n\r]{0,12}";
    let leaf = prop_oneof![
        any::<bool>().prop_map(Value::Bool),
        any::<i32>().prop_map(Value::Int),
        proptest::num::f64::NORMAL.prop_map(Value::Double),
        text.prop_map(Value::String),
        any::<Vec<u8>>().prop_map(Value::Bytes),
        Just(Value::DateTime("19980717T14:08:55".to_owned())),
    ];
    leaf.prop_recursive(4, 32, 5, move |inner| {
        prop_oneof![
            proptest::collection::vec(inner.clone(), 0..5).prop_map(Value::Array),
            proptest::collection::btree_map(text, inner, 0..5).prop_map(Value::Struct),
        ]
    })
}

#[test]
fn documents_of_other_writers_are_read() {
    // As Python's xmlrpc.client writes it, with untyped text, an empty value, comments and CDATA.
    let xml = b"<?xml version='1.0'?>\n<methodCall>\n<methodName>m</methodName>\n<params>\n\
        <param>\n<value><array><data>\n<value><int>1</int></value>\n<value> a &amp; b </value><value/>\
        <value><string>x<!-- y -->z</string></value><value><![CDATA[<]]></value><value><i4> -7 </i4></value>\
        <value><double>1e-3</double></value><value><boolean>1</boolean></value>\n</data></array></value>\n</param>\n\
        </params>\n</methodCall>\n";
    let expected: Vec<Value> = vec![
        1.into(),
        " a & b ".into(),
        "".into(),
        "xz".into(),
        "<".into(),
        (-7).into(),
        0.001.into(),
        true.into(),
    ];
    assert_eq!(Call::from_xml(xml), Ok(Call::new("m", vec![Value::Array(expected)])));
    let none = b"<methodCall><methodName>m</methodName></methodCall>";
    assert_eq!(Call::from_xml(none), Ok(Call::new("m", vec![])));
}

#[test]
fn faults_are_read_as_answers() {
    let fault = Fault { code: -1, message: "<nothing> & no one".to_owned() };
    assert_eq!(answer_from_xml(answer_to_xml(&Err(fault.clone())).as_bytes()), Ok(Err(fault)));
}

#[test]
fn entities_are_not_followed() {
    let laughs = b"<!DOCTYPE a [<!ENTITY b \"ha\"><!ENTITY c \"&b;&b;\">]>\
        <methodCall><methodName>&c;</methodName></methodCall>";
    assert!(matches!(Call::from_xml(laughs), Err(XmlRpcError::Xml(_))));
}

#[test]
fn nesting_is_bounded() {
    for (depth, fits) in [(31, true), (32, false), (100_000, false)] {
        let (open, close) = ("<value><array><data>".repeat(depth), "</data></array></value>".repeat(depth));
        let xml = format!(
            "<methodResponse><params><param>{open}<value>x</value>{close}</param></params></methodResponse>"
        );
        assert_eq!(answer_from_xml(xml.as_bytes()).is_ok(), fits, "{depth}");
    }
}

#[test]
fn other_documents_are_rejected() {
    let answers = [
        "",
        "<methodCall/>",
        "<methodResponse/>",
        "<methodResponse><params><param/></params></methodResponse>",
        "<methodResponse><params><param><value><int>x</int></value></param></params></methodResponse>",
        "<methodResponse><params><param><value><int>2147483648</int></value></param></params></methodResponse>",
        "<methodResponse><params><param><value><nil/></value></param></params></methodResponse>",
        "<methodResponse><fault><value>text</value></fault></methodResponse>",
    ];
    for answer in answers {
        assert!(answer_from_xml(answer.as_bytes()).is_err(), "{answer}");
    }
}

proptest! {
    #[test]
    fn values_come_back(values in proptest::collection::vec(value(), 0..4)) {
        let call = Call::new("method", values.clone());
        prop_assert_eq!(Call::from_xml(call.to_xml().as_bytes()), Ok(call));
        for value in values {
            prop_assert_eq!(answer_from_xml(answer_to_xml(&Ok(value.clone())).as_bytes()), Ok(Ok(value)));
        }
    }

    #[test]
    fn any_text_can_be_written(text in any::<String>()) {
        let call = Call::new("m", vec![text.as_str().into()]);
        let read = Call::from_xml(call.to_xml().as_bytes()).unwrap();
        prop_assert_eq!(read.arguments[0].as_str().unwrap().chars().count(), text.chars().count());
    }

    #[test]
    fn no_bytes_panic(bytes in any::<Vec<u8>>(), tags in "(<(/?)(value|array|data|struct|member|name|int|param)>|x|&|;){0,30}") {
        let _ = (Call::from_xml(&bytes), answer_from_xml(&bytes));
        let tagged = format!("<methodResponse><params><param><value>{tags}</value></param></params></methodResponse>");
        let _ = answer_from_xml(tagged.as_bytes());
    }
}
