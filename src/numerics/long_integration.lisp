;;; anmech: integration with many digits, by power series.
;;;
;;; A *long field* finds the coefficients of all states at a state and time, from the series program of a model.  A
;;; *long integration* keeps the states where steps begin and, as long as there is room, their coefficients; those of
;;; later steps are found again, alike, for whoever asks for a state within one.
;;;
;;; The order follows from the tolerance, the step from the two last coefficients (Jorba and Zou), both with the error
;;; of a step below the tolerance, relative to the largest size of each state so far.  Where something decays fast, the
;;; last coefficients are all its, long after it has died out: then stability bounds the steps, as it does in doubles
;;; (steps.lisp), only that they grow with the order.
;;;
;;; Entry points: NEW-LONG-FIELD; the structure LONG-INTEGRATION; INTEGRATE-LONG, LONG-ORDER, LONG-STATES-AT,
;;; LONG-START, LONG-NODE-COUNT, LONG-NODE, TIME-WITHIN, LONG-UNKNOWNS, SIZES-SEEN, LONG-STEPS-NEEDED,
;;; WAY-OF-VANISHING-STEPS, GREATEST-OF, *BEGUN-PART*.
;;;
;;; Literature: A. Jorba, M. Zou, A software package for the numerical integration of ODEs by means of high-order Taylor
;;; methods, Experimental Mathematics 14 (2005) 99-117.

(in-package :anmech)
(needs "session/patience" "arithmetic/floats" "numerics/dag" "numerics/evaluation" "numerics/model"
       "numerics/long_numbers" "numerics/long_series" "numerics/series_program" "numerics/steps")

;;; Coefficients

(defstruct long-field
  program bits order
  states                     ; how many
  series                     ; vector: of states, time, instructions
  advancers                  ; of the instructions, functions (k)
  constants                  ; vector of long constants
  rates                      ; for each state a series
  linear                     ; LONG-EQUATIONS, or nil
  (sizes nil)                ; units of states: exponents
  (shift 0) (place nil))     ; of the step whose coefficients it holds

(defstruct long-equations
  "A u = b in series: lists (row column series), series, and the unknowns."
  entries rights unknowns
  inverse                    ; of A[0], long constants, a vector of vectors
  units)                     ; of what is left of each right side

(defun new-long-field (program inputs bits order)
  "INPUTS: exact states, time, parameters."
  (let* ((*long-bits* bits) (n (series-program-states program)) (instructions (series-program-instructions program))
         (constants (map 'vector #'long-constant (constant-values program (long-numbers bits) inputs)))
         (series (coerce (loop repeat (+ n 1 (length instructions)) collect (new-long-series order)) 'vector))
         (linear (series-program-linear program))
         (unknowns (and linear
                        (coerce (loop repeat (linear-series-size linear) collect (new-long-series order)) 'vector))))
    (flet ((series (number) (aref series number)) (constant (number) (aref constants number)))
      (flet ((operand (operand)
               (cond ((integerp operand) (series operand))
                     ((eq :unknown (car operand)) (aref unknowns (cdr operand)))
                     (t (constant (cdr operand))))))
        (make-long-field
         :program program :bits bits :order order :states n :series series :constants constants
         :advancers (loop for instruction across instructions
                          for place from (1+ n)
                          collect (advancer instruction (aref series place) #'series #'constant))
         :rates (mapcar #'operand (series-program-rates program))
         :linear (and linear
                      (make-long-equations
                       :entries (loop for (i j entry) in (linear-series-entries linear)
                                      collect (list i j (operand entry)))
                       :rights (map 'vector #'operand (linear-series-rights linear))
                       :unknowns unknowns)))))))

(defparameter *longest-coefficient* 50000 "Of so many bits: the unit of time is much too long.")
(defparameter *long-coefficient* 10000 "So many would do.")

(defun expand-long (field states time units shift)
  "Find the coefficients at STATES, rational numbers, in UNITS, exponents, and at TIME, in powers of the time by
2^SHIFT.  Nil; or as soon as they are so large that it is not worth while, by how much less SHIFT had better be."
  (let ((*long-bits* (long-field-bits field)) (series (long-field-series field)) (n (long-field-states field)))
    (setf (long-field-shift field) shift (long-field-place field) nil)
    (loop for i from 0
          for state across states
          for unit across units
          do (begin-in-units (aref series i) state unit))
    (begin-time (aref series n) time shift)
    (dotimes (k (long-field-order field) nil)
      (loop for advance in (long-field-advancers field)
            for place from 0
            do (handler-case (funcall (the function advance) k)
                 (domain-violation (condition) (tell-violation condition field place))))
      (when (long-field-linear field) (advance-unknowns (long-field-linear field) k))
      (let ((longest (loop for rate in (long-field-rates field)
                           for i from 0
                           do (advance-state (aref series i) rate shift k)
                           maximize (integer-length (coefficient (aref series i) (1+ k))))))
        (when (> longest *longest-coefficient*)
          (return (ceiling (- longest *long-coefficient*) (1+ k))))))))

(defun tell-violation (condition field place)
  "CONDITION came up in the instruction at PLACE."
  (let ((guard (cdr (assoc place (series-program-guards (long-field-program field)))))
        (operation (violated-operation condition)))
    (if (eq operation :overflow)
        (error condition)
        (error 'domain-violation :operation (or (car guard) operation) :source (cdr guard)))))

(defun begin-time (series time shift)
  "A time that is near 0 has its bits, too, however long the step may be."
  (let ((unit (unit-for (if (zerop time) (expt 2 shift) (abs time)))))
    (begin-in-units series time unit)
    (setf (svref (long-series-coefficients series) 1) (integer-in-units (expt 2 shift) unit))))

(defun advance-state (state rate shift k)
  "The coefficient of order k + 1 by that of the rate of order k."
  (setf (svref (long-series-coefficients state) (1+ k))
        (floor (ash (coefficient rate k) (- (+ (long-series-exponent rate) shift) (long-series-exponent state)))
               (1+ k))))

;;; A u = b

(defun advance-unknowns (equations k)
  (if (zerop k) (begin-unknowns equations) (continue-unknowns equations k)))

(defun begin-unknowns (equations)
  (let* ((size (length (long-equations-rights equations)))
         (rows (loop repeat size collect (make-list size :initial-element 0)))
         (rights (long-equations-rights equations)))
    (loop for (i j entry) in (long-equations-entries equations)
          do (setf (nth j (nth i rows)) (first-rational entry)))
    (let ((inverse (or (long-inverse rows *long-bits*) (error 'domain-violation :operation :solve :source nil))))
      (setf (long-equations-inverse equations)
            (map 'vector (lambda (row) (map 'vector #'long-constant row)) inverse)
            (long-equations-units equations) (map 'vector #'long-series-exponent rights))
      (loop for row across (long-equations-inverse equations)
            for unknown across (long-equations-unknowns equations)
            do (setf (long-series-exponent unknown)
                     (+ *long-bits* (or (greatest-of
                                    (loop for part across row
                                          for right across rights
                                          unless (or (eql 0 (long-series-constant part))
                                                     (eql 0 (long-series-constant right)))
                                            collect (+ (long-series-exponent part) (long-series-exponent right))))
                                   (* -2 *long-bits*)))))
      (set-unknowns equations (map 'vector (lambda (right) (coefficient right 0)) rights) 0)
      (loop for (i j entry) in (long-equations-entries equations)
            do (unless (long-series-constant entry)
                 (setf (aref (long-equations-units equations) i)
                       (max (aref (long-equations-units equations) i)
                            (+ *long-bits* (long-series-exponent entry)
                               (long-series-exponent (aref (long-equations-unknowns equations) j))))))))))

(defun continue-unknowns (equations k)
  (let* ((units (long-equations-units equations))
         (left (map 'vector (lambda (right unit)
                              (ash (coefficient right k) (- (long-series-exponent right) unit)))
                    (long-equations-rights equations) units)))
    (loop for (i j entry) in (long-equations-entries equations)
          do (unless (long-series-constant entry)
               (let ((unknown (aref (long-equations-unknowns equations) j)))
                 (decf (aref left i)
                       (ash (products (long-series-coefficients entry) (long-series-coefficients unknown) k 1)
                            (- (+ (long-series-exponent entry) (long-series-exponent unknown)) (aref units i)))))))
    (set-unknowns equations left k)))

(defun set-unknowns (equations left k)
  "The coefficients of order K: the inverse of A[0] times LEFT, integers in their units."
  (loop for row across (long-equations-inverse equations)
        for unknown across (long-equations-unknowns equations)
        do (setf (svref (long-series-coefficients unknown) k)
                 (loop for part across row
                       for value across left
                       for unit across (long-equations-units equations)
                       sum (ash (* (coefficient part 0) value)
                                (- (+ (long-series-exponent part) unit) (long-series-exponent unknown)))))))

(defun long-unknowns (model inputs bits)
  "The unknowns of MODEL, rational numbers, where its inputs are INPUTS."
  (let ((values (funcall (the function (program-function (model-exact-program model) (long-numbers bits))) inputs))
        (arrangement (model-arrangement model)) (count (length (model-unknowns model))))
    (if (null arrangement)
        (nthcdr (model-solved model) values)
        (let* ((linear (linear-series-of arrangement values)) (size (linear-series-size linear))
               (rows (loop repeat size collect (make-list size :initial-element 0))))
          (loop for (i j entry) in (linear-series-entries linear) do (setf (nth j (nth i rows)) entry))
          (let ((inverse (or (long-inverse rows bits) (error 'domain-violation :operation :solve :source nil))))
            (flet ((solution (i)
                     (rounded (reduce #'+ (map 'list #'* (aref inverse i) (linear-series-rights linear))) bits)))
              (mapcar (lambda (found) (if (consp found) (solution (cdr found)) found))
                      (unknown-rates arrangement values count))))))))

;;; States within a step

(defparameter *step-bits* 24 "Steps are such parts of a power of two: to multiply by them is cheap.")

(defun state-series (field)
  "Those of the states, a list."
  (coerce (subseq (long-field-series field) 0 (long-field-states field)) 'list))

(defun long-values (series part order bits)
  "The states where the part PART of 2^shift has passed since the step began, of which a list has the SERIES: a vector
of rational numbers."
  (coerce (values-of-series series part order bits) 'vector))

(defun values-of-series (list part order bits)
  "Those of the series in LIST at PART, of which BITS matter."
  (let ((part (integer-in-units part (- bits))))
    (flet ((value (series)
             (let* ((coefficients (long-series-coefficients series)) (sum (svref coefficients order)))
               (loop for k from (1- order) downto 0
                     do (setq sum (+ (ash (* sum part) (- bits)) (svref coefficients k))))
               (in-units sum (long-series-exponent series)))))
      (mapcar #'value list))))

;;; Steps

(defun long-order (tolerance)
  "An even number; TOLERANCE is a binary logarithm."
  (max 8 (* 2 (ceiling (- 1 (* tolerance 0.25d0 (log 2d0)))))))

(defparameter *noise-bits* 10 "Coefficients of fewer bits are what was cut off.")

(defun coefficient-size (field k sizes)
  "The binary logarithm of the largest coefficient of order K of a state, in proportion to its size; nil if all vanish."
  (greatest-of (loop for i below (long-field-states field)
                    for series = (aref (long-field-series field) i)
                    for integer = (coefficient series k)
                    for size across sizes
                    unless (or (null size) (< (integer-length integer) *noise-bits*))
                      collect (- (+ (binary-logarithm integer) (long-series-exponent series)) size))))

(defun greatest-of (numbers)
  "The largest of a list; nil if there is none."
  (and numbers (reduce #'max numbers)))

(defun step-exponent (field tolerance sizes)
  "The binary logarithm of the longest step by 2^shift; nil if the series end before: then it may be longer."
  (let* ((order (long-field-order field))
         (found (loop for k in (list order (1- order))
                      for size = (coefficient-size field k sizes)
                      when size collect (/ (- tolerance size) k))))
    (and found (- (reduce #'min found) 0.01d0))))

(defparameter *least-size* -1100 "A binary logarithm, below that of doubles: what is smaller counts as nothing.")

(defun sizes-seen (sizes states &optional (least (make-array (length sizes) :initial-element *least-size*)))
  "Binary logarithms of the largest sizes of states, nil where they were 0 until now; none is below LEAST."
  (map 'vector (lambda (size state least)
                 (if (zerop state) size (max (or size least) (binary-logarithm state))))
       sizes states least))

(defparameter *begun-part* 20 "A binary logarithm: to a millionth of its largest size is what begins at 0 known.")

(defun least-long-sizes (states before)
  "Below which those of STATES, where an integration begins, do not count: what begins at 0 grows, as the integration
BEFORE knows; without that, it counts as of no size that others do not have."
  (let* ((sizes (map 'list (lambda (state) (if (zerop state) 0 (binary-logarithm state))) states))
         (least (reduce #'min sizes :initial-value *least-size*)))
    (map 'vector (lambda (state begun size)
                   (cond ((not (zerop state)) begun)
                         (size (- size *begun-part*))
                         (t least)))
         states sizes
         (if before (long-integration-sizes before) (make-array (length states) :initial-element nil)))))

(defun units-of-sizes (sizes bits)
  (map 'vector (lambda (size) (- (if size (ceiling size) 0) bits)) sizes))

(defun sizes-of-series (integration sizes)
  "SIZES, with those of states that begin at 0 as the first terms of their rates tell them: terms of higher order grow
with the unit of time, and would always seem to be small beside the largest of them; and the series of such a state may
be nothing but what is cut off in its unit, which is chosen before anything is known of it."
  (let* ((field (long-integration-field integration)) (order (long-field-order field)))
    (map 'vector (lambda (size least rate)
                   (or size
                       (multiple-value-bind (size k) (size-of-first-term rate (1- order))
                         (and size (max least (- (+ size (long-field-shift field)) (log (+ 1d0 k) 2d0)))))))
         sizes (long-integration-least integration) (long-field-rates field))))

(defun size-of-first-term (series last)
  "The binary logarithm of the coefficient of the lowest order until LAST that is more than noise, and that order; or
nil."
  (loop for k from 0 to last
        for integer = (coefficient series k)
        when (>= (integer-length (abs integer)) *noise-bits*)
          return (values (+ (binary-logarithm integer) (long-series-exponent series)) k)))

(defparameter *kept-bits* (expt 2 26) "So much series are kept.")

(defstruct long-integration
  field
  probe                     ; another field, of order 1, that gives rates within a step
  (nodes nil)               ; vector of lists (time states units shift series) where steps begin; series: or nil
  (room *kept-bits*)        ; for series
  time states               ; at the end
  sizes least               ; binary logarithms of the largest sizes, and of those that count at all
  (accepted 0) (evaluations 0)
  (stiff 0) (mild 0)        ; how many of the last steps were bounded by stability, and how many others among them
  (stiff-since nil)         ; when the first of those began, and how many steps there were before it
  (stiff-count 0)
  (last-step 0)
  (unhelped 0)              ; in how many steps halving them did not make the rates those of the series
  (stiffness nil)           ; where that is no chance: a pair of the time when it was seen, and the rate of decay
  (trouble nil))            ; what has ended it: a condition, :interrupted, :too-many-steps, :stiff, :vanishing,
                            ; :too-short; or nil

(defun integrate-long (program inputs end stops tolerance order bits most-steps progress before)
  "From the exact INPUTS to END, by steps that end at STOPS, too, exact times in the order of the motion; TOLERANCE is a
binary logarithm.  BEFORE is an integration whose first step is about as long, or nil."
  (let* ((field (new-long-field program inputs bits order)) (n (long-field-states field))
         (integration (make-long-integration :field field :probe (new-long-field program inputs bits 1)
                                             :time (elt inputs n)
                                             :states (map 'vector (lambda (state) (rounded state bits))
                                                          (subseq inputs 0 n))
                                             :sizes (make-array n :initial-element nil)
                                             :least (least-long-sizes (subseq inputs 0 n) before)))
         (nodes (make-array 64 :adjustable t :fill-pointer 0)) (shift (and before (first-shift before)))
         (start (elt inputs n)) (clock (get-internal-real-time)))
    (loop until (= (long-integration-time integration) end)
          do (poll)
             (when (eql (long-integration-time integration) (first stops)) (setq stops (rest stops) shift nil))
             (when (setf (long-integration-trouble integration)
                         (cond ((interrupted-p) :interrupted)
                               ((>= (long-integration-accepted integration) most-steps) :too-many-steps)
                               ((long-vanishing-p integration nodes end) :vanishing)
                               ((long-impatient-p integration end most-steps)
                                (if (way-of-vanishing-steps nodes (long-integration-time integration))
                                    :vanishing
                                    :stiff))
                               (t (multiple-value-bind (node trouble)
                                      (long-step integration start (or (first stops) end) tolerance shift)
                                    (when node
                                      (setq shift (shift-after node (long-integration-time integration)))
                                      (vector-push-extend node nodes))
                                    trouble))))
               (return))
             (when (and progress (> (- (get-internal-real-time) clock) (/ internal-time-units-per-second 2)))
               (setq clock (get-internal-real-time))
               (funcall progress (to-double (/ (- (long-integration-time integration) start) (- end start))))))
    (setf (long-integration-nodes integration) (coerce nodes 'simple-vector))
    integration))

(defun first-shift (integration)
  (and (plusp (long-node-count integration)) (fourth (svref (long-integration-nodes integration) 0))))

(defun shift-after (node time)
  "That of the step from TIME on, if it is as long as the one that began at NODE, or a little longer."
  (ceiling (+ 0.125d0 (binary-logarithm (- time (first node))))))

(defun long-step (integration start end tolerance shift)
  "Go on by one step of the way from START: its node, or nil, and the trouble."
  (handler-case
      (let* ((field (long-integration-field integration)) (time (long-integration-time integration))
             (states (long-integration-states integration)) (left (- end time)))
        (multiple-value-bind (shift units longest) (settled-expansion integration tolerance shift left)
          (let* ((part (min-part longest (/ (abs left) (expt 2 shift))))
                 (root (vanishing-root field (* (signum left) part)))
                 (part (part-as-rates-say integration tolerance shift units
                                          (if root (before-root field (* (signum left) part)) part) (signum left)))
                 (last (= part (/ (abs left) (expt 2 shift))))
                 (step (* (signum left) part (expt 2 shift)))
                 (node (list time states units shift (kept-series integration))))
            (cond ((and (not last) (too-short-p step (- time start) (long-field-bits field)))
                   (values nil (if root (violation-of-root field root) :too-short)))
                  (t (unless last (watch-long-stability integration part (signum left)))
                     (setf (long-integration-states integration)
                           (long-values (state-series field) (* (signum left) part) (long-field-order field)
                                        (if last (+ 8 (long-field-bits field)) *step-bits*))
                           (long-integration-time integration) (if last end (+ time step))
                           (long-integration-last-step integration) step
                           (long-integration-sizes integration)
                           (sizes-seen (sizes-of-series integration (long-integration-sizes integration))
                                       (long-integration-states integration) (long-integration-least integration)))
                     (incf (long-integration-accepted integration))
                     (values node nil))))))
    (domain-violation (condition) (values nil condition))))

(defun kept-series (integration)
  "The series of the states, as the field has them now, a list; nil where there is no room for them."
  (let ((field (long-integration-field integration)))
    (and (plusp (decf (long-integration-room integration)
                      (* (long-field-states field) (long-field-order field) (long-field-bits field))))
         (loop for series in (state-series field)
               collect (make-long-series :coefficients (copy-seq (long-series-coefficients series))
                                         :exponent (long-series-exponent series))))))

;;; Stability

(defparameter *stable-part* 0.3d0 "Where a series ends at a pole, its last terms decay at less than such a part of the
order in a step.")

(defun watch-long-stability (integration part direction)
  "Count the steps that stability bounds; this one is PART of the unit of the series."
  (let* ((field (long-integration-field integration)) (unit (expt 2 (long-field-shift field)))
         (rate (decay-of-series field (long-integration-sizes integration) direction)))
    (cond ((> (* rate part) (* *stable-part* (long-field-order field)))
           (when (zerop (long-integration-stiff integration))
             (setf (long-integration-stiff-since integration) (long-integration-time integration)
                   (long-integration-stiff-count integration) (long-integration-accepted integration)))
           (setf (long-integration-mild integration) 0)
           (when (and (= (incf (long-integration-stiff integration)) *stiff-steps*)
                      (null (long-integration-stiffness integration)))
             (setf (long-integration-stiffness integration)
                   (cons (to-double (long-integration-time integration))
                         (nearest-finite-double (/ (rational rate) unit))))))
          ((= (incf (long-integration-mild integration)) *mild-steps*)
           (setf (long-integration-stiff integration) 0 (long-integration-mild integration) 0)))))

(defun decay-of-series (field sizes direction)
  "The rate, by the unit of time, of what decays fastest, a double: the last coefficients of series that stability
bounds are all its, and change their signs; 0 where they do not."
  (let ((order (long-field-order field)))
    (multiple-value-bind (last last-unit) (coefficients-in-proportion field order sizes)
      (multiple-value-bind (before before-unit) (coefficients-in-proportion field (1- order) sizes)
        (flet ((dot (a b) (reduce #'+ (map 'list #'* a b))))
          (if (and last before
                   (< (* direction (dot last before)) (* -0.9d0 (sqrt (* (dot last last) (dot before before))))))
              (* order (expt 2d0 (max -900 (min 900 (+ (log (sqrt (/ (dot last last) (dot before before))) 2d0)
                                                       (- last-unit before-unit))))))
              0d0))))))

(defun coefficients-in-proportion (field k sizes)
  "Those of order K of the states, in proportion to their SIZES, as doubles in units of the largest, and the binary
logarithm of that; nil if all vanish."
  (let ((greatest (coefficient-size field k sizes)))
    (and greatest
         (values (loop for i below (long-field-states field)
                       for series = (aref (long-field-series field) i)
                       for integer = (coefficient series k)
                       for size across sizes
                       collect (if (or (null size) (< (integer-length integer) *noise-bits*))
                                   0d0
                                   (* (signum integer)
                                      (expt 2d0 (max -1000 (- (+ (binary-logarithm integer)
                                                                 (long-series-exponent series))
                                                              size greatest))))))
                 greatest))))

(defun long-impatient-p (integration end most-steps)
  "Whether stability bounds the steps, and they are going to be too many."
  (and (> (long-integration-stiff integration) *stiff-steps*)
       (zerop (rem (long-integration-accepted integration) *patient-steps*))
       (not (long-steps-grow-p integration))
       (> (long-steps-needed integration end) most-steps)))

(defun long-steps-grow-p (integration)
  "Whether the last step is so long beside the others that stability has bounded that what decays does so slower and
slower, like 1/t."
  (let ((since (long-integration-stiff-since integration)))
    (> (* (abs (long-integration-last-step integration))
          (- (long-integration-accepted integration) (long-integration-stiff-count integration)))
       (* 10 (abs (- (long-integration-time integration) since))))))

(defparameter *fewest-vanishing* 400 "So many steps tell how their lengths go on.")
(defparameter *vanishing-part* 3/4)

(defun way-of-vanishing-steps (nodes time)
  "How far steps will come that go on as those from NODES, a vector, until TIME, if each half of these has come so much
less far than the half before it: nowhere, though no single one is too short.  So they do where functions of what goes
to infinity change faster and faster, which is a singularity, and not stiffness.  Nil of others."
  (let ((count (length nodes)))
    (when (>= count *fewest-vanishing*)
      (flet ((way (from to) (abs (- (if (= to count) time (first (aref nodes to))) (first (aref nodes from))))))
        (let* ((half (floor count 2)) (quarter (floor half 2)) (eighth (floor quarter 2))
               (last (way half count)) (before (way quarter half)))
          (and (< last (* *vanishing-part* before))
               (< before (* *vanishing-part* (way eighth quarter)))
               (/ (* last last) (- before last))))))))

(defparameter *hopeless-steps* 10000 "So many lead to no other side.")

(defun long-vanishing-p (integration nodes end)
  "Whether its steps, those from NODES, will never come to END, nor near it."
  (and (>= (length nodes) *hopeless-steps*)
       (zerop (rem (length nodes) *patient-steps*))
       (let* ((time (long-integration-time integration)) (way (way-of-vanishing-steps nodes time)))
         (and way (> (abs (- end time)) (* 2 way))))))

(defun long-steps-needed (integration end)
  "How many steps the way would take in all, if those to come are as long as those that stability has bounded."
  (let ((count (long-integration-accepted integration)) (time (long-integration-time integration))
        (since (or (long-integration-stiff-since integration) (long-start integration))))
    (if (= time since)
        count
        (+ count (ceiling (* (- count (long-integration-stiff-count integration)) (/ (- end time) (- time since))))))))

(defun too-short-p (step way bits)
  "Whether STEP is none beside the WAY until now: so steps end before a singularity.  The first ones may be as short as
they like."
  (or (zerop step)
      (and (/= 0 way)
           (< (binary-logarithm step) (- (binary-logarithm way) (* 1/2 bits))))))

(defun violation-of-root (field place)
  (let ((guard (cdr (assoc place (series-program-guards (long-field-program field))))))
    (make-condition 'domain-violation :operation (or (car guard) :sqrt) :source (cdr guard))))

(defun min-part (longest left)
  "The smaller one of the step, 2^LONGEST, with few bits, and of what is LEFT."
  (let ((part (and longest (< longest (+ 2 (binary-logarithm left)))
                   (/ (floor (* (expt 2d0 longest) (ash 1 *step-bits*))) (ash 1 *step-bits*)))))
    (if (and part (< part left)) part left)))

(defun root-places (field)
  "The numbers of instructions that are roots."
  (loop for (operation nil exponent) across (series-program-instructions (long-field-program field))
        for place from 0
        when (or (eq :sqrt operation)
                 (and (eq :power operation)
                      (not (integerp (long-series-constant (aref (long-field-constants field) exponent))))))
          collect place))

(defun vanishing-root (field part)
  "The number of a root that has changed its sign at PART, or nil: a series goes on through where what it is taken of
vanishes, a root does not."
  (let ((places (root-places field)) (n (long-field-states field)) (series (long-field-series field)))
    (and places
         (loop for place in places
               for value in (values-of-series (mapcar (lambda (place) (aref series (+ n 1 place))) places) part
                                              (1- (long-field-order field)) *step-bits*)
               unless (plusp value) return place))))

(defun before-root (field part)
  "The last part of PART, in the units of steps, at which no root has changed its sign."
  (let ((low 0) (high (abs (integer-in-units part (- *step-bits*)))))
    (loop while (< low (1- high))
          do (let ((middle (ash (+ low high) -1)))
               (if (vanishing-root field (* (signum part) (in-units middle (- *step-bits*))))
                   (setq high middle)
                   (setq low middle))))
    (in-units low (- *step-bits*))))

(defparameter *places-of-probes* '(1 5/8)
  "Parts of a step at which its series must be what the equations say: the first one, if it is no longer than usual.")
(defparameter *longer-than-usual* 3/2 "Than the last one.")
(defparameter *defect-bits* 12 "By so many the part of a rate that they do not share may be more than the tolerance.")
(defparameter *most-halvings* 16)
(defparameter *most-unhelped* 20)

(defun part-as-rates-say (integration tolerance shift units part direction)
  "PART, or its half, or the half of that: until at its end, and before, the rates are those of the series.  A series
knows nothing of what vanishes among its bits where it begins, as tanh(1000 x) - 1 does until x is near 0.  PART itself
if halving does not help: then the rates are noise, as beside an equilibrium; where that is so again and again, nobody
looks any more."
  (flet ((fits-p (part)
           (every (lambda (place)
                    (series-holds-p integration tolerance shift units (* direction place part)))
                  (if (> (* part (expt 2 shift)) (* *longer-than-usual* (abs (long-integration-last-step integration))))
                      *places-of-probes*
                      (list (first *places-of-probes*))))))
    (loop repeat (if (< (long-integration-unhelped integration) *most-unhelped*) *most-halvings* 0)
          for length = part then (in-units (integer-in-units (/ length 2) (- *step-bits*)) (- *step-bits*))
          until (zerop length)
          when (fits-p length) return length
          finally (incf (long-integration-unhelped integration))
                  (return part))))

(defun series-holds-p (integration tolerance shift units part)
  "Whether the rates at PART of the unit are those of the series; true where they have no value."
  (let* ((field (long-integration-field integration)) (probe (long-integration-probe integration))
         (part (in-units (integer-in-units part (- *step-bits*)) (- *step-bits*)))
         (series (state-series field)) (order (long-field-order field))
         (states (long-values series part order *step-bits*))
         (sizes (sizes-seen (long-integration-sizes integration) states (long-integration-least integration)))
         (most (+ tolerance *defect-bits* (log order 2d0))))
    (handler-case
        (progn (expand-long probe states (+ (long-integration-time integration) (* part (expt 2 shift))) units shift)
               (loop for found in (state-series probe)
                     for slope in (slopes-of-series series part order)
                     for size across sizes
                     for least across (long-integration-least integration)
                     for defect = (* part (- (coefficient found 1) slope))
                     always (or (zerop defect)
                                (<= (- (+ (binary-logarithm defect) (long-series-exponent found)) (or size least))
                                    most))))
      (domain-violation () t))))

(defun slopes-of-series (list part order)
  "The derivatives of the series in LIST at PART, integers in the units of these."
  (let ((part (integer-in-units part (- *step-bits*))))
    (loop for series in list
          for coefficients = (long-series-coefficients series)
          collect (let ((sum 0))
                    (loop for k from order downto 1
                          do (setq sum (+ (ash (* sum part) (- *step-bits*)) (* k (svref coefficients k)))))
                    sum))))

(defparameter *most-shifted* 2
  "The unit of a series is the step or larger, by such a power of two at most: so no coefficient is cut off that
matters.  A step that might be longer, by less than a factor of two, is as long as the unit.")
(defparameter *farthest-unit* 16 "By no larger power of two is it changed at first; then by twice as much each time.")

(defun settled-expansion (integration tolerance shift left)
  "Expand at the states: the shift, the units, and the binary logarithm of the longest step by 2^shift.  The units of
time and of states that are 0 are found by trying."
  (let* ((field (long-integration-field integration)) (states (long-integration-states integration))
         (bits (long-field-bits field)) (shift (or shift (1- (ceiling (binary-logarithm left)))))
         (sizes (sizes-seen (long-integration-sizes integration) states (long-integration-least integration)))
         (units (units-of-sizes sizes bits)))
    (flet ((expand ()
             (loop for excess = (expand-long field states (long-integration-time integration) units shift)
                   while excess do (decf shift excess))
             (incf (long-integration-evaluations integration) (long-field-order field))))
      (loop repeat 16
            for farthest = *farthest-unit* then (min 1000 (* 2 farthest))
            do (expand)
               (let* ((known (sizes-of-series integration sizes)) (wanted (units-of-sizes known bits))
                      (longest (step-exponent field tolerance known))
                      (room (- (binary-logarithm left) shift))
                      (far (ceiling (max (- farthest) (min farthest room (or longest farthest)))))
                      (near (<= (- *most-shifted*) far 1)))
                 (when (and near
                            (every (lambda (unit wanted) (<= (abs (- unit wanted)) 16)) units wanted))
                   (return (values shift units (min 0 (or longest 0)))))
                 ;; what is cut off in a unit that is too coarse tells nothing of the step
                 (if (or near (some (lambda (unit wanted) (> (- unit wanted) 16)) units wanted))
                     (setq units wanted)
                     (setq shift (+ shift far))))
            ;; coefficients that are noise in one unit and large in the next: no step longer than the unit is known
            finally (expand)
                    (return (values shift units
                                    (or (step-exponent field tolerance (sizes-of-series integration sizes)) 0)))))))

;;; Reading

(defun long-node-count (integration) (length (long-integration-nodes integration)))

(defun long-node (integration place)
  "The time and the states where the step at PLACE begins."
  (destructuring-bind (time states &rest others) (svref (long-integration-nodes integration) place)
    (declare (ignore others))
    (values time states)))

(defun long-states-at (integration time)
  "A vector of rational numbers; TIME, a rational number, is between the ends."
  (if (= time (long-integration-time integration))
      (long-integration-states integration)
      (let* ((field (long-integration-field integration)) (nodes (long-integration-nodes integration))
             (place (long-place nodes time (long-integration-time integration)))
             (node (svref nodes place)))
        (destructuring-bind (begin states units shift kept) node
          (unless (or kept (eq node (long-field-place field)))
            (expand-long field states begin units shift)
            (setf (long-field-place field) node))
          (if (= time begin)
              states
              (long-values (or kept (state-series field)) (/ (- time begin) (expt 2 shift)) (long-field-order field)
                           (+ 8 (long-field-bits field))))))))

(defun long-place (nodes time end)
  (let ((low 0) (high (1- (length nodes))) (forward (<= (first (svref nodes 0)) end)))
    (loop while (< low high)
          do (let ((middle (ceiling (+ low high) 2)))
               (if (if forward (<= (first (svref nodes middle)) time) (>= (first (svref nodes middle)) time))
                   (setq low middle)
                   (setq high (1- middle)))))
    low))

(defun long-start (integration)
  (if (plusp (long-node-count integration)) (values (long-node integration 0)) (long-integration-time integration)))

(defun time-within (integration time)
  "TIME, which may have been rounded beyond the ends."
  (let* ((start (long-start integration)) (end (long-integration-time integration))
         (low (min start end)) (high (max start end)))
    (max low (min high (rational time)))))
