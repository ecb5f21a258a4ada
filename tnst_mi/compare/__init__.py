"""Our integrator checked against Mitsuba's path tracer, a closed form and finite differences (`tnst-mi compare`).

closed_form  float64 references    values  images    gradients  derivatives    quadrature_study  step size against error
verdict  the checks    figures, report  the output    comparison  all of it
"""
