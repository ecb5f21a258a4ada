"""Our integrator checked against Mitsuba's path tracer, float64 references, finite differences (`tnst-mi compare`).

closed_form, inclusive_sum  float64 references    values  images    gradients  derivatives
paper_quadrature  the sum that drives a stylization    quadrature_study  step size against error
verdict  the checks    figures, report  the output    comparison  all of it
"""
