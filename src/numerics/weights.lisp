;;; anmech: the sizes that errors of a motion are measured by.
;;;
;;; Of every state, the error counts in units of the largest size that it has had so far; but not less than what is
;;; known of its size (a state may begin at zero), and not less than what rounding makes of the terms that it consists
;;; of: its grain, which where disturbances die out within a step is only what is left of them.  Late times are
;;; rounded, too: what that makes of a step grows with its length, and so does the error that it may have.
;;;
;;; Entry points: the structure WEIGHTS; FIRST-WEIGHTS, MEASURED-WEIGHTS, RENEWED-WEIGHTS; CLEAR-OF-NOISE-P;
;;; GROWING-TOLERANCE; LARGEST-DIFFERENCE, LEAST-ALONG, RAISE-SIZES, *NOISE*.

(in-package :anmech)
(needs "arithmetic/floats" "arithmetic/linear" "numerics/arrangement" "numerics/integration" "numerics/model"
       "numerics/surfaces")

(defstruct weights
  least          ; of each state: the size that it is taken to have at least
  grains         ; in the order of time, pairs of a time and, of each state there, the size of the terms it is made of
  late           ; in the order of time, structures of what the rounding of time does; nil: nothing
  floor)         ; of each state: the error of a step that is noise

(defstruct late
  "What relative changes of time do to the states in a step of the length h: h times RATES, and h^2 times BENDS, through
other states."
  time           ; from which on that holds
  step           ; the length of the step there
  rates bends)

;; told beforehand, GCL passes the arguments unboxed
(declaim (ftype (function (t t fixnum fixnum double-float) t) raise-to-sizes raise-sizes)
         (ftype (function (t t t t) double-float) largest-difference))

(defparameter *rounding* 1d-16 "The part of the grain below which the error of a step is noise.")
(defparameter *late-rounding* 3d-16 "The part of what a relative change of time does that is noise.")
(defparameter *late-bending* 3d-15 "The same through other states: formulas magnify what is within a step.")
(defparameter *noise* 1d-14 "The part of it below which a difference after many steps is.")

(defun rate-terms (field point n amplitudes rates scratch)
  "Raise RATES to how much each rate changes in proportion to relative changes of the single states."
  (declare (type function field) (fixnum n) (type (simple-array double-float (*)) point amplitudes rates))
  (destructuring-bind (in before after found) scratch
    (declare (type (simple-array double-float (*)) in before after found))
    (replace in point)
    (fill found 0d0)
    (handler-case
        (progn
          (funcall field in before)
          (for (j n)
            (let ((state (aref in j)))
              (declare (double-float state))
              (setf (aref in j) (flo (+ state (* 1d-6 (aref amplitudes j)))))
              (funcall field in after)
              (setf (aref in j) state))
            (add-changes before after found))
          (raise-to-sizes rates before 0 1 1d0)
          (raise-to-sizes rates found 0 1 1d6))
      ((or domain-violation arithmetic-error) () nil))))

(defun add-changes (before after found)
  (declare (type (simple-array double-float (*)) before after found))
  (with-fast-arithmetic
    (for (i (length found))
      (setf (aref found i) (flo (+ (aref found i) (abs (- (aref after i) (aref before i)))))))
    nil))

(defun surfaces-slid-on (model point)
  "Those whose sides in POINT are none, for the motion stays between them."
  (let ((surfaces (model-surfaces model)))
    (and surfaces
         (loop for i from 0 below (surfaces-count surfaces)
               when (< (abs (side-at surfaces point i)) 1d0) collect i))))

(defun rates-on-sides (model point n sliding rates)
  "Raise RATES to their sizes on both sides of the surfaces SLIDING: where a motion slides, they are means of these."
  (let* ((surfaces (model-surfaces model)) (in (copy-seq point)) (found (zeros n)))
    (dolist (i sliding)
      (dolist (side '(1 -1))
        (put-signs surfaces in)
        (put-side surfaces in i side)
        (handler-case (progn (funcall (the function (model-smooth-field model)) in found)
                             (map-into rates (lambda (rate other) (max rate (abs other))) rates found))
          ((or domain-violation arithmetic-error) () nil))))))

(defparameter *small-change* 1d-7 "By this part entries are changed to see what depends on them.")
(defparameter *changes* 4 "So often.")

(defun random-changes (count)
  "Some arrays of COUNT factors next to 1, of either sign, the same at every call."
  (let ((seed 1))
    (loop repeat *changes*
          collect (map-into (zeros count)
                            (lambda ()
                              (setq seed (mod (* 16807 seed) 2147483647))
                              (if (logbitp 10 seed) (+ 1d0 *small-change*) (- 1d0 *small-change*)))))))

(defun multiply-by (array factors)
  (declare (type (simple-array double-float (*)) array factors))
  (with-fast-arithmetic
    (for (k (length array)) (setf (aref array k) (flo (* (aref array k) (aref factors k)))))
    nil))

(defun solution-terms-meter (model)
  "A function (in) that tells how much each of the unknowns of A u = b at IN changes in proportion to relative
changes of the entries of A and b.  The changes are drawn at random a few times: the condition that Skeel has defined,
but for the
exact bound."
  (let* ((size (length (model-unknowns model)))
         (found (zeros size)) (plain (zeros size)) (other (zeros size))
         (all-changes (random-changes (length (model-equations model)))) (changes nil)
         (system (model-system model)) (solver (model-solver model))
         (changed (unknowns-function (model-arrangement model)
                                     (lambda (in entries)
                                       (funcall (the function system) in entries)
                                       (multiply-by entries changes))
                                     '() size)))
    (declare (type function changed solver))
    (lambda (in)
      (fill found 0d0)
      (handler-case
          (progn
            (funcall solver in plain)
            (dolist (some all-changes)
              (setq changes some)
              (funcall changed in other)
              (raise-to-changes found plain other)))
        ((or domain-violation arithmetic-error) () nil))
      found)))

(defun raise-to-changes (found plain other)
  (declare (type (simple-array double-float (*)) found plain other))
  (with-fast-arithmetic
    (let ((part *small-change*))
      (declare (double-float part))
      (for (i (length found))
        (setf (aref found i) (flo (max (aref found i) (/ (abs (- (aref plain i) (aref other i))) part)))))
      nil)))

(defun grain-meter (model)
  "That of NEW-GRAIN-METER, made once for MODEL: a short motion takes no longer than to make it."
  (or (model-meter model) (setf (model-meter model) (new-grain-meter model))))

(defun new-grain-meter (model)
  "A function (point period) that gives the grain of each state: what the terms of its rate give in the short time
PERIOD.  POINT is like the input of the field, with the sides that hold there: next to a surface that a motion leaves
or slides along, the changes lead across it, and what jumps there is no term.  A second round brings in states that are
zero themselves, but whose rates have terms that cancel.  The first value is what is left of it if disturbances die out
within the period; the second one is not damped."
  (let* ((n (model-dimension model)) (amplitudes (zeros n)) (rates (zeros n)) (solved (model-solved model))
         (scratch (list (zeros (length (model-inputs model))) (zeros n) (zeros n) (zeros n)))
         (terms-meter (and (model-arrangement model) (solution-terms-meter model))))
    (lambda (point period)
      (let ((grain (zeros n))
            (field (model-smooth-field model))                ; which may have been compiled anew (HASTEN-FIELD)
            (terms (and terms-meter (funcall (the function terms-meter) point)))
            (sliding (surfaces-slid-on model point)))
        (flet ((go-round ()
                 (fill rates 0d0)
                 (when terms (replace rates (the double-array terms) :start1 solved))
                 (when sliding (rates-on-sides model point n sliding rates))
                 (replace amplitudes grain)
                 (raise-to-sizes amplitudes point 0 1 1d0)
                 (rate-terms field point n amplitudes rates scratch)
                 (raise-to-terms grain rates period)))
          (let* ((first (copy-seq (go-round)))
                 (second (if (raised-by-p amplitudes grain) (copy-seq (go-round)) first)))
            (values (if (and (> (largest-ratio second first) *far-too-long*)
                             (> (largest-ratio (go-round) second) *far-too-long*))
                        (or (damped-disturbance field point n period first) first)
                        second)
                    second)))))))

(defun raised-by-p (amplitudes grain)
  "Whether a second round would see larger amplitudes."
  (declare (type (simple-array double-float (*)) amplitudes grain))
  (with-fast-arithmetic
    (for (i (length grain)) (when (> (aref grain i) (aref amplitudes i)) (return-from raised-by-p t)))
    nil))

(defparameter *far-too-long* 100d0
  "A step of so many times that in which a disturbance dies out: only implicit methods take it, and damp disturbances.")

(defun largest-ratio (numbers others)
  (declare (type (simple-array double-float (*)) numbers others))
  (let ((largest 0d0))
    (declare (double-float largest))
    (with-fast-arithmetic
      (for (i (length numbers))
        (when (> (aref others i) 0d0) (setq largest (flo (max largest (/ (aref numbers i) (aref others i))))))))
    largest))

(defun damped-disturbance (field point n period sizes)
  "What is left of disturbances of SIZES, of any signs, after an implicit step of the length PERIOD: (1 - period J)^-1
times them, J the Jacobian matrix at POINT.  Nil if there is none."
  (let ((matrix (damping-matrix field point n period)) (left (zeros n)))
    (and matrix
         (dolist (factors (random-changes n) left)
           (let ((found (map-doubles ((size sizes) (factor factors)) (if (> factor 1d0) size (flo (- size))))))
             (unless (solve-linear-in-place n (copy-seq matrix) found) (return nil))
             (raise-to-sizes left found 0 1 1d0))))))

(defun damping-matrix (field point n period)
  "1 - PERIOD J by rows, J by differences; nil where the field has no values."
  (declare (type function field))
  (let ((matrix (zeros (* n n))) (in (copy-seq point)) (before (zeros n)) (after (zeros n)))
    (handler-case
        (progn
          (funcall field in before)
          (dotimes (j n matrix)
            (let* ((state (aref in j)) (change (* 1d-6 (max (abs state) (* period (abs (aref before j))) 1d-290))))
              (setf (aref in j) (+ state change))
              (funcall field in after)
              (setf (aref in j) state)
              (dotimes (i n)
                (setf (aref matrix (+ j (* i n)))
                      (- (if (= i j) 1d0 0d0) (/ (* period (- (aref after i) (aref before i))) change)))))))
      ((or domain-violation arithmetic-error) () nil))))

(defun raise-to-terms (grain rates period)
  (declare (double-float period) (type (simple-array double-float (*)) grain rates))
  (with-fast-arithmetic
    (for (i (length grain))
      (when (< (aref rates i) 1d200)
        (setf (aref grain i) (flo (max (aref grain i) (* period (aref rates i)))))))
    grain))

(defun late-at (problem point step)
  "The structure LATE of the time and the states in POINT, where a step has the length STEP."
  (declare (double-float step))
  (let* ((n (problem-n problem)) (time (abs (aref point n))) (in (copy-seq point))
         (before (zeros n)) (after (zeros n)) (shift (max (* 1d-3 step) (* 2d-12 time))) (way (* 1d-6 step step))
         (late (make-late :time (aref point n) :step step :rates (zeros n) :bends (zeros n)))
         (field (model-smooth-field (problem-model problem))))
    (declare (type function field) (double-float time shift way))
    (flet ((changes (by)
             (funcall field in after)
             (map-doubles ((a before) (b after)) (/ (- b a) (the double-float by))))
           (sizes (changes) (map-doubles ((change changes)) (min 1d200 (* time (abs change))))))
      (unless (or (zerop shift) (< way 1d-300))
        (handler-case
            (progn
              (funcall field in before)
              (incf (aref in n) shift)
              (let ((rates (changes shift)))
                (setf (late-rates late) (sizes rates))
                (replace in (map-doubles ((rate rates) (state point)) (+ state (* way rate))))
                (setf (aref in n) (aref point n))
                (setf (late-bends late) (sizes (changes way)))))
          ((or domain-violation arithmetic-error) () nil))))
    late))

(defun between-points (lates)
  "Those that hold from each of LATES on until the next: of both, the larger numbers."
  (loop for (late next) on lates
        collect (if next
                    (make-late :time (late-time late) :step (late-step late)
                               :rates (map-doubles ((a (late-rates late)) (b (late-rates next))) (max a b))
                               :bends (map-doubles ((a (late-bends late)) (b (late-bends next))) (max a b)))
                    late)))

(defun raise-to-late (tolerances sizes late step factor)
  "TOLERANCES are SIZES, but not less than FACTOR times what LATE says of a step of the length STEP."
  (declare (type (simple-array double-float (*)) tolerances sizes) (double-float step factor))
  (let* ((rates (late-rates late)) (bends (late-bends late))
         (calm (calming sizes rates bends step))
         (first (* calm factor *late-rounding*)) (second (* calm calm factor *late-bending*)))
    (declare (type (simple-array double-float (*)) rates bends) (double-float calm first second))
    (with-fast-arithmetic
      (for (i (length tolerances))
        (setf (aref tolerances i)
              (flo (max (aref sizes i)
                        (* step (+ (* first (aref rates i)) (* second (* step (aref bends i)))))))))
      nil)))

(defun calming (sizes rates bends step)
  "1, or the part to which a stiff equation damps a disturbance within STEP: as the implicit methods have it, 1/(h J),
where J takes RATES to BENDS."
  (declare (type (simple-array double-float (*)) sizes rates bends) (double-float step))
  (let ((slow 0d0) (fast 0d0))
    (declare (double-float slow fast))
    (with-fast-arithmetic
      (for (i (length sizes))
        (when (> (aref sizes i) 1d-280)
          (setq slow (flo (max slow (/ (aref rates i) (aref sizes i))))
                fast (flo (max fast (/ (aref bends i) (aref sizes i)))))))
      (setq fast (flo (* step fast))))
    (if (> fast slow) (/ slow fast) 1d0)))

(defun noise-floor (problem points)
  "The error of a step below which it is noise, of each state; POINTS: lists of a point, the step there and its grains,
damped or not."
  (let* ((n (problem-n problem)) (floor (make-array n :element-type 'double-float :initial-element 1d300))
         (part *rounding*))
    (declare (type (simple-array double-float (*)) floor) (double-float part))
    (with-fast-arithmetic
      (loop for (nil nil nil all) in points
            do (let ((grain all))
                 (declare (type (simple-array double-float (*)) grain))
                 (for (i n) (setf (aref floor i) (flo (min (aref floor i) (aref grain i)))))))
      (for (i n) (setf (aref floor i) (flo (* part (aref floor i)))))
      floor)))

(defun first-weights (problem)
  "Before anything is known but the beginning."
  (let* ((start (on-its-sides problem (copy-seq (problem-start problem))))
         (n (problem-n problem))
         (t0 (problem-time problem))
         (rates (first-rates problem))
         (period (* 0.01d0 (abs (- (problem-end problem) t0)))))
    (dotimes (i n)
      (let ((state (abs (aref start i))) (rate (abs (aref rates i))))
        (when (and (plusp state) (< state (* rate period)))
          (setq period (/ state rate)))))
    (setq period (calm-period problem start rates period))
    (let ((grain (funcall (grain-meter (problem-model problem)) start period)))
      (make-weights :least (least-from-rest (map-doubles ((rate rates)) (* 0.01d0 period (abs rate))) start)
                    :grains (list (cons t0 grain))
                    :late (and (problem-timed problem) (list (late-at problem start period)))
                    :floor (noise-floor problem (list (list start period grain grain)))))))

(defun calm-period (problem start rates period)
  "PERIOD, or a shorter one, in a hundredth of which the RATES of states that begin at 0 neither fall to less than half
nor turn: else these states never come to what their rates at START tell."
  (let* ((first (rates-at problem start)) (places (and first (telling-places start first rates))))
    (if places
        (loop with calm-p = (calm-test problem start first places)
              for shorter = period then (* 0.1d0 shorter)
              while (> shorter 1d-290)
              when (funcall (the function calm-p) (* 0.01d0 shorter)) return shorter
              finally (return period))
        period)))

(defun rates-at (problem point)
  "Those in POINT, or nil where there are none."
  (let ((rates (zeros (problem-n problem))))
    (handler-case (progn (funcall (the function (problem-field problem)) point rates) rates)
      ((or domain-violation arithmetic-error) () nil))))

(defun telling-places (start first rates)
  "The places of states that begin at 0, with rates FIRST that are no less than half of RATES, which some time is the
largest, and take part in the size of what moves."
  (declare (type double-array start first rates))
  (let ((part (* *negligible* (reduce #'max rates))))
    (declare (double-float part))
    (loop for i below (length rates)
          when (and (= 0d0 (aref start i))
                    (< 0d0 (aref rates i))
                    (<= part (aref rates i))
                    (<= (* 0.5d0 (aref rates i)) (abs (aref first i))))
            collect i)))

(defun calm-test (problem start first places)
  "A function (part) that tells whether of the rates FIRST those in PLACES are still there, half as large or more, after
steps of the length PART: one of Euler's method, and one by the rates that it leads to."
  (declare (type double-array start first))
  (let* ((n (problem-n problem)) (field (problem-field problem)) (rates (zeros n)) (in (copy-seq start))
         (forward (>= (problem-end problem) (problem-time problem))))
    (declare (type function field) (type double-array rates in))
    (lambda (part)
      (let ((way (if forward part (- part))))
        (declare (double-float way))
        (handler-case
            (progn
              (replace rates first)
              (loop repeat 2
                    always (progn
                             (dotimes (i n) (setf (aref in i) (+ (aref start i) (* way (aref rates i)))))
                             (setf (aref in n) (+ (aref start n) way))
                             (funcall field in rates)
                             (still-there-p first rates places))))
          ((or domain-violation arithmetic-error) () nil))))))

(defun still-there-p (first rates places)
  (declare (type double-array first rates))
  (loop for i in places
        always (let ((before (aref first i)) (after (aref rates i)))
                 (declare (double-float before after))
                 (if (minusp before) (<= after (* 0.5d0 before)) (>= after (* 0.5d0 before))))))

(defparameter *looks* 64 "At how many times a field that depends on time is looked at before the first step.")
(defparameter *largest-later* 1d100 "A larger rate is not met later: how long it lasts is not known.")

(defun first-rates (problem)
  "The sizes of the rates at the beginning; where the field depends on time the largest of some times, at the same
states: a system at rest may be set in motion later."
  (let* ((n (problem-n problem)) (largest (zeros n)) (rates (zeros n)) (in (copy-seq (problem-start problem)))
         (t0 (problem-time problem)) (way (- (problem-end problem) t0)))
    (loop for k from 0 to (if (problem-timed problem) *looks* 0)
          for bound = (if (zerop k) 1d290 *largest-later*)
          do (setf (aref in n) (+ t0 (* way (/ (float k 1d0) *looks*))))
             (handler-case (progn (funcall (the function (problem-field problem)) in rates)
                                  (setq largest (map-doubles ((size largest) (rate rates))
                                                             (if (< (flo (abs rate)) (the double-float bound))
                                                                 (flo (max size (abs rate)))
                                                                 size))))
               ((or domain-violation arithmetic-error) () nil)))
    largest))

(defun least-from-rest (least start)
  "LEAST, where a state that is at rest in 0 has a small part of what the others have: nothing else tells of its size."
  (let ((part (* 1d-6 (reduce #'max least))))
    (declare (double-float part))
    (map-doubles ((size least) (state start)) (if (= state 0d0) (flo (max size part)) size))))

(defparameter *points* 12 "At how many points the grain is measured.")
(defparameter *negligible* 1d-6
  "The part of its largest size that a state which begins at 0 is taken to have at least: what grows out of rest, like
t^5, would be asked for digits that no one can see.")

(defparameter *of-others* 1d-3
  "The part of the largest of all that a state which stays at 0 is taken to have: what rounding leaves there, in
equations that hold it, is no error of the size of the motion.")

(defun largest-sizes (integration n until)
  "The largest size of each state where steps begin, up to the time UNTIL; nil: to the end."
  (or (and (null until) (integration-largest integration))
      (let* ((largest (zeros n)) (state (zeros n)) (kept (states-kept integration))
             (end (1+ (if until (step-place (integration-times integration) until) (step-count integration)))))
        (raise-sizes largest (integration-states integration) 0 (min kept end) 1d0)
        (loop for place from kept below end
              do (raise-sizes largest (state-of-step integration place state) 0 1 1d0))
        largest)))

(defun raise-sizes (largest states first end factor)
  "Raise LARGEST, of each state, to its size times FACTOR in each of STATES from the place FIRST on, below END; these
stand one after the other."
  (declare (fixnum first end) (double-float factor))
  (when (< first end)
    (raise-to-sizes largest states first end factor))
  largest)

(defun raise-to-sizes (largest states first end factor)
  (declare (fixnum first end) (double-float factor) (type (simple-array double-float (*)) largest states))
  (with-fast-arithmetic
    (let* ((n (length largest)) (place (fix (* n first))))
      (declare (fixnum n place))
      (for (k end first)
        (for (i n)
          (setf (aref largest i) (flo (max (aref largest i) (* factor (abs (aref states (fix (+ place i))))))))
          nil)
        (setq place (fix (+ place n))))
      nil)))

(defun places-of-points (count points)
  "Of COUNT steps those from whose beginnings about so many POINTS are taken."
  (loop for place from 0 below count by (max 1 (ceiling count points)) collect place))

(defun beginning-of-step (problem integration place)
  "Where the step at PLACE begins, like the input of the field."
  (let ((point (copy-seq (problem-start problem))))
    (state-of-step integration place point)
    (setf (aref point (problem-n problem)) (aref (the double-array (integration-times integration)) place))
    (if (integration-sides integration)
        (funcall (the function (integration-sides integration)) point)
        (on-its-sides problem point))))

(defun on-its-sides (problem point)
  "POINT, in which the sides are noted where it lies."
  (let ((surfaces (model-surfaces (problem-model problem))))
    (if surfaces (put-signs surfaces point) point)))

(defparameter *late-points* 60 "At how many points it is measured what late times do, where they do anything.")

(defun lates-along (problem integration points)
  "The structures LATE along INTEGRATION; nil where times are too early to be seen at POINTS, lists of a point and the
step there."
  (and (loop for (point step) in points
             thereis (late-counts-p (late-at problem point step) (integration-largest integration)))
       (between-points
        (loop for place in (places-of-points (step-count integration) *late-points*)
              collect (late-at problem (beginning-of-step problem integration place)
                               (abs (step-length integration place)))))))

(defun late-counts-p (late sizes)
  (some (lambda (rate bend size)
          (let ((step (late-step late)))
            (> (* step (+ (* *late-rounding* rate) (* *late-bending* step bend)))
               (* 1d-15 (the double-float size)))))
        (late-rates late) (late-bends late) sizes))

(defun measured-weights (problem integration &optional until)
  "From a motion that has been integrated, up to the time UNTIL."
  (let* ((n (problem-n problem))
         (meter (grain-meter (problem-model problem)))
         (points (loop for place in (places-of-points (step-count integration) *points*)
                       collect (let ((point (beginning-of-step problem integration place))
                                     (period (abs (step-length integration place))))
                                 (list* point period
                                        (multiple-value-list (funcall (the function meter) point period)))))))
    (make-weights :least (least-along problem integration until)
                  :grains (grains-along points n)
                  :late (and (problem-timed problem) (lates-along problem integration points))
                  :floor (if points (noise-floor problem points) (zeros n)))))

(defun grains-along (points n)
  "The grains at POINTS, lists of a point, the step there and its grain, and of the time from the point before on those
that terms of a growing size have there: in proportion to the state, if that grows."
  (let ((sizes (zeros n)) (found '()) (last nil))
    (loop for (point nil grain) in points
          do (when last
               (push (cons last (grain-before grain sizes point)) found))
             (setq last (aref point n))
             (push (cons last grain) found)
             (raise-sizes sizes (subseq point 0 n) 0 1 1d0))
    (nreverse found)))

(defun grain-before (grain sizes point)
  "GRAIN, of the terms at POINT, as it may have been when the states had had SIZES."
  (map-doubles ((there grain) (size sizes) (state point))
               (let ((here (flo (abs state))))
                 (declare (double-float here))
                 (if (and (< 0d0 size) (< size here)) (flo (* there (/ size here))) there))))

(defun least-along (problem integration until)
  (let* ((start (problem-start problem))
         (n (problem-n problem))
         (largest (and (find 0d0 start :end n :test #'=) (largest-sizes integration n until)))
         (least (zeros n)))
    (dotimes (i n least)
      (when (zerop (aref start i))
        (setf (aref least i) (if (plusp (aref largest i))
                                 (* *negligible* (aref largest i))
                                 (* *of-others* (reduce #'max largest))))))))

(defun renewed-weights (problem integration weights accuracy)
  "From a finer motion than the one along which WEIGHTS were measured: where rounding is far from mattering, what it
does is not measured again."
  (if (and (rest (weights-grains weights)) (null (weights-late weights))
           (clear-of-noise-p accuracy weights (integration-largest integration)))
      (let ((renewed (copy-weights weights)))
        (setf (weights-least renewed) (least-along problem integration nil))
        renewed)
      (measured-weights problem integration)))

(defparameter *clear-of-noise* 100d0 "By what a wanted error is to exceed the noise of a step to be far from rounding.")

(defun clear-of-noise-p (accuracy weights sizes)
  (declare (double-float accuracy))
  (loop for (nil . grain) in (weights-grains weights)
        always (smaller-in-parts-p (* *clear-of-noise* *rounding*) grain accuracy sizes)))

(defun smaller-in-parts-p (part numbers other-part others)
  "Whether PART of each of NUMBERS is not above OTHER-PART of that of OTHERS."
  (declare (double-float part other-part) (type (simple-array double-float (*)) numbers others))
  (dotimes (i (length numbers) t)
    (unless (<= (* part (aref numbers i)) (* other-part (aref others i))) (return nil))))

(defun growing-tolerance (weights part problem)
  "The tolerance of a step that is PART of the largest size so far of each state: its observer lets it grow with them;
where late times are rounded, with the steps, too."
  (declare (double-float part))
  (let* ((sizes (map-doubles ((least (weights-least weights)) (floor (weights-floor weights)))
                             (max (* part least) floor)))
         (late (weights-late weights))
         (tolerances (if late (copy-seq sizes) sizes))
         (adapt (and late (adapting-to-late tolerances sizes late problem)))
         (observer (lambda (in)
                     (raise-to-sizes sizes in 0 1 part)
                     (when adapt (funcall (the function adapt) in))
                     nil)))
    (funcall observer (problem-start problem))
    (make-tolerance :relative (* 0.1d0 part) :absolute tolerances :observer observer)))

(defun adapting-to-late (tolerances sizes late problem)
  "A function, to be called with the input of the field after each step, that makes TOLERANCES of SIZES for the next
one: what the rounding of time does counts in proportion to the steps."
  (let ((n (problem-n problem)) (before (problem-time problem)) (step (late-step (first late)))
        (forward (>= (problem-end problem) (problem-time problem)))
        (factor (if (problem-noise problem) 3d0 1d0)))        ; that of the check is moved by a unit besides
    (declare (double-float before step) (fixnum n))
    (lambda (in)
      (let ((time (aref (the double-array in) n)))
        (declare (double-float time))
        (loop for next = (second late)
              while (and next (if forward (>= time (late-time next)) (<= time (late-time next))))
              do (pop late))
        (unless (= time before) (setq step (abs (- time before)) before time))
        (raise-to-late tolerances sizes (first late) step factor)))))

;;; Differences in these sizes

(defun largest-difference (state other largest differences)
  "Of two states, in units of LARGEST, their largest sizes so far, which are brought up to date, as are the largest
DIFFERENCES of each."
  (declare (type (simple-array double-float (*)) state other largest differences))
  (with-fast-arithmetic
    (let ((worst 0d0))
      (declare (double-float worst))
      (for (i (length state))
        (setf (aref largest i) (flo (max (aref largest i) (abs (aref state i)))))
        (let ((difference (flo (abs (- (aref state i) (aref other i))))))
          (declare (double-float difference))
          (when (> difference 0d0)
            (setf (aref differences i) (flo (max (aref differences i) difference)))
            (setq worst (flo (max worst (/ difference (max (aref largest i) +least-size+))))))))
      worst)))
