"""The description of a program for FMI 3.0."""

from __future__ import annotations

from xml.etree import ElementTree

from flysid.export.fmu_facts import Facts, as_xml


def fmi3_description(facts: Facts, identity: str) -> bytes:
    """modelDescription.xml of FMI 3.0."""
    root = facts.root("3.0", instantiationToken=identity)
    can = {"canGetAndSetFMUState": "true", "canSerializeFMUState": "true"}
    step = {"canHandleVariableCommunicationStepSize": "false", "fixedInternalStepSize": repr(facts.dt_s)}
    ElementTree.SubElement(root, "CoSimulation", {"modelIdentifier": facts.name} | can | step)
    facts.add_units(root)
    ElementTree.SubElement(root, "DefaultExperiment", {"stepSize": repr(facts.dt_s)})
    variables = ElementTree.SubElement(root, "ModelVariables")
    for at, v in enumerate(facts.variables):
        unit = {"unit": v.unit} if v.unit else {}
        ElementTree.SubElement(
            variables, "Float64", {"name": v.name, "valueReference": str(at)} | v.kind | v.begins | unit
        )
    names = {v.name for v in facts.variables}
    clock = next(name for name in ("time", "simulation_time", "fmi_time") if name not in names)
    independent = {"causality": "independent", "variability": "continuous"}
    ElementTree.SubElement(
        variables, "Float64", {"name": clock, "valueReference": str(len(facts.variables))} | independent
    )
    structure = ElementTree.SubElement(root, "ModelStructure")
    for group in ("Output", "InitialUnknown"):
        for at in facts.outputs:
            depends = " ".join(map(str, facts.depends(group == "InitialUnknown")))
            ElementTree.SubElement(structure, group, {"valueReference": str(at), "dependencies": depends})
    return as_xml(root)


def fmi3_build(name: str) -> bytes:
    """sources/buildDescription.xml."""
    root = ElementTree.Element("fmiBuildDescription", {"fmiVersion": "3.0"})
    build = ElementTree.SubElement(root, "BuildConfiguration", {"modelIdentifier": name})
    files = ElementTree.SubElement(build, "SourceFileSet", {"language": "C99"})
    for file in (f"{name}.c", "fmi3.c"):
        ElementTree.SubElement(files, "SourceFile", {"name": file})
    ElementTree.SubElement(build, "Library", {"name": "m", "external": "true"})
    return as_xml(root)
