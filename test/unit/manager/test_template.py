# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Templates: sets of terms, products, one-pass substitution, and the caps before expansion."""

from itertools import product
from math import prod
from xml.sax.saxutils import escape

import pytest
from hypothesis import given
from hypothesis import strategies as st
from unit.manager.test_ontology import loader

from dyknow.errors import SpecificationError
from dyknow.manager.specifications.limits import SpecificationLimits
from dyknow.manager.specifications.specification import parse
from dyknow.model.transformation import Parameter, Port

TERMS = st.text(st.sampled_from("ab1 ${}X<&"), min_size=1, max_size=6).map(str.strip)
SETS = st.lists(TERMS.filter(bool), min_size=1, max_size=4, unique=True)


#: Classes; one individual has no label, one has no name, and one has a comma in its label.
CLASSES = """
:Camera a owl:Class . :back a :Camera . :front a :Camera ; rdfs:label "front" . [] a :Camera .
<urn:lens> a owl:Class . <urn:x> a owl:Class .
:wide a <urn:lens> ; rdfs:label "front, wide" . :left a <urn:lens> ; rdfs:label "left" .
"""


@pytest.fixture(scope="module")
def ontology(tmp_path_factory):
    return loader(tmp_path_factory.mktemp("ontology"))(CLASSES)


def template(label, args, extra=""):
    written = "".join(f'<arg label="{n}">{escape(terms)}</arg>' for n, terms in args.items())
    return (
        f"<transformation><label>{label}</label><source>p/A</source>"
        f"<args>{written}</args>{extra}</transformation>"
    )


def labels_of(text, **kwargs):
    return [t.label for t in parse(text, **kwargs).transformations]


def problems_of(text, **kwargs):
    with pytest.raises(SpecificationError) as caught:
        parse(text, **kwargs)
    return [problem.message for problem in caught.value.problems]


def test_what_a_term_brings_in_is_not_substituted_again():
    text = template("${A},${B}", {"A": "{${B}; ${A}; $${B}}", "B": "{b}"})

    assert labels_of(text) == ["${B},b", "${A},b", "$${B},b"]


@given(st.lists(SETS, min_size=1, max_size=3))
def test_several_args_give_their_product(sets):
    sets = [[term for term in terms if ";" not in term] for terms in sets]
    names = [f"X{number}" for number in range(len(sets))]
    label = "|".join(f"${{{name}}}" for name in names)
    written = {name: "{" + "; ".join(terms) + "}" for name, terms in zip(names, sets)}
    expected = ["|".join(values) for values in product(*sets)]

    text = template(label, written)

    assert labels_of(text) == expected
    assert len(expected) == prod(map(len, sets))
    assert problems_of(text, limits=SpecificationLimits(transformations=len(expected) - 1))


def test_the_terms_may_be_the_individuals_of_a_class(ontology):
    text = template("l(${Cam})", {"Cam": "http://example.org/#Camera"})

    assert labels_of(text, ontology=ontology) == ["l(back)", "l(front)"]
    warned = parse(text, ontology=ontology).warnings
    assert [(each.line > 0, each.message) for each in warned] == [
        (
            True,
            "individuals of the class <http://example.org/#Camera> that have neither a URI nor a "
            "label are left out: 1",
        ),
        (
            True,
            "the individual <http://example.org/#back> has no label; it goes by the last part "
            "of its URI",
        ),
    ]


@pytest.mark.parametrize(
    ("terms", "tag", "is_warned"),
    [
        ("urn:lens", "Image(${C})", True),
        ("urn:lens", "Image(cam)", False),
        ("{front, wide; left}", "Image(${C})", False),  # two arguments on purpose
    ],
)
def test_an_individual_that_is_no_single_argument_is_warned_about(ontology, terms, tag, is_warned):
    ports = f"<ports><port type='out'>o</port></ports><tags><tag port='o'>{tag}</tag></tags>"
    found = parse(template("a ${C}", {"C": terms}, ports), ontology=ontology)
    expected = "the individual 'front, wide' is no single argument of a tag"
    assert [each.message.split(":")[0] for each in found.warnings] == [expected] * is_warned


def test_a_class_without_individuals_is_a_problem(ontology):
    text = template("l(${Cam})", {"Cam": "urn:x"})

    assert problems_of(text, ontology=ontology) == [
        "the arg 'Cam' has no terms: the class <urn:x> has no individuals"
    ]


def test_a_template_that_cannot_be_expanded_has_its_ports_checked_all_the_same():
    extra = (
        '<ports><port type="in" datatype="sensor_msgs/${T}">in_${X}</port></ports>'
        '<tags><tag port="out_${X}">A(b)</tag></tags>'
    )

    with pytest.raises(SpecificationError) as caught:
        parse(template("${X}", {"X": "{a}"}, extra))
    assert [problem.message for problem in caught.value.problems] == [
        "unknown variable ${T}; known variables: X (write $${ for ${ itself)",
        "the tag is for the port 'out_${X}', which is not declared; known ports: in_${X}; did you "
        "mean in_${X}?",
    ]
    assert caught.value.warnings == ()


def test_a_problem_of_every_expansion_is_told_once():
    extra = '<tags><tag port="raw-camera">Raw(${X})</tag></tags>'

    assert problems_of(template("${X}", {"X": "{a; b; c}"}, extra)) == [
        "the tag is for the port 'raw-camera', which is not declared; known ports: none"
    ]


def test_a_small_text_that_would_become_a_huge_one_is_refused_before():
    terms = "{" + "; ".join(str(number) for number in range(1000)) + "}"
    extra = '<params><param name="p" type="string">' + "x" * 500_000 + "</param></params>"

    (message,) = problems_of(template("${X}", {"X": terms}, extra))

    assert message.endswith("characters would result in all; expected at most 268435456")


def test_a_value_that_would_become_too_long_is_refused_before():
    extra = '<params><param name="p" type="string">' + "${X}" * 1000 + "</param></params>"

    assert problems_of(
        template("${X}", {"X": "{" + "x" * 100 + "}"}, extra),
        limits=SpecificationLimits(string_length=50_000),
    ) == ["a value of 100000 characters would result; expected at most 50000"]


def test_variables_are_replaced_in_every_text():
    found = parse(
        """<transformation cost="${N}"><label>${N}</label><source>p/${T}</source>
          <args><arg label="N">{1; 2}</arg><arg label="T">{Image}</arg></args>
          <params><param name="p${N}" type="int">${N}</param>
            <param name="q">${N}.5</param>
            <param name="home" type="string">$${T} costs 5$ or $$</param></params>
          <ports><port type="in" datatype="sensor_msgs/${T}">in${N}</port></ports>
          <tags><tag port="in${N}">${T}(${N})</tag></tags></transformation>"""
    )

    second = found.transformations[1]
    assert (second.label, second.source, second.cost) == ("2", "p/Image", 2)
    assert second.parameters == (
        Parameter("p2", "int", "2"),
        Parameter("q", "double", "2.5"),
        Parameter("home", "string", "${T} costs 5$ or $$"),
    )
    assert second.ports == (Port("in2", "in", "sensor_msgs/Image", ("Image(2)",)),)


def test_the_transformations_of_all_templates_count_together():
    one = template("a${X}", {"X": "{1; 2}"})
    two = template("b${X}", {"X": "{1; 2}"})
    text = f"<transformations>{one}{two}</transformations>"

    assert len(labels_of(text, limits=SpecificationLimits(transformations=4))) == 4
    assert problems_of(text, limits=SpecificationLimits(transformations=3)) == [
        "4 transformations in this text; expected at most 3"
    ]
