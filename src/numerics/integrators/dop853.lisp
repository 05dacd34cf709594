;;; anmech: Dormand and Prince's explicit Runge-Kutta method of order 8 with error estimates of orders 5 and 3.
;;;
;;; Entry points: DOP853, DENSE-VALUE, the structure INTEGRATION.
;;;
;;; A field is a function (in out) of double arrays: IN holds the n states, the time, and whatever parameters the field
;;; has; OUT receives the n rates. All stages are written into that one array IN, so a step allocates nothing.
;;;
;;; Literature: E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary Differential Equations I, 2nd ed. 1993, II.4
;;; (initial step, step control), II.5 (the method), II.6 (dense output of order 7), and IV.2 of volume II (PI control).
;;; The coefficients are those of the authors' program dop853.f, rounded to the nearest double.

(in-package :anmech)
(needs "session/texts" "arithmetic/floats")

(defstruct integration
  steps            ; a vector of arrays (time, step, eight coefficients of each state); empty unless dense
  (interpolant 'interpolate)      ; function (element-of-steps time out n); another method's steps look different
  start            ; first time
  time             ; time reached
  final            ; state there
  accepted rejected evaluations
  status           ; :ok, :stopped, :too-many-steps, :step-too-small, :domain or :not-finite
  message)         ; what happened, a sentence; nil if all is well

(defun integration-times (integration)
  "The times between the steps of a dense integration, from the first to the last."
  (let* ((steps (integration-steps integration))
         (times (make-array (1+ (length steps)) :element-type 'double-float)))
    (dotimes (i (length steps))
      (setf (aref times i) (aref (the double-array (svref steps i)) 0)))
    (setf (aref times (length steps)) (integration-time integration))
    times))

;;; What a run keeps

(defstruct (solver (:conc-name run-))
  field
  (in nil :type double-array)
  (n 0 :type fixnum)
  (state nil :type double-array)         ; at the beginning of the step
  (next nil :type double-array)          ; at its end
  (stages nil :type simple-vector)       ; the rates k1 to k16
  (control nil :type double-array)       ; see WITH-CONTROL
  (absolute nil :type double-array)
  (accepted 0 :type fixnum)
  (rejected 0 :type fixnum)
  (evaluations 0 :type fixnum)
  (after-rejection nil)
  (trouble nil)                          ; why a step failed: a condition, or :not-finite
  (dense nil)
  (steps '())
  (observer nil)
  (max-steps 0 :type fixnum)
  (progress nil)
  (progress-time 0))

(defmacro with-control ((solver) &body body)
  "BODY where (control QUANTITY) is a number that changes from step to step. They are kept in an array, unboxed."
  `(with-fast-arithmetic
     (let ((control (run-control ,solver)))
       (declare (type (simple-array double-float (*)) control))
       (macrolet ((control (quantity)
                    `(aref control
                           ,(position quantity
                                      '(time step end direction relative longest error previous-error start)))))
         ,@body))))

(defmacro with-stages ((solver) &body body)
  "BODY with what a step needs as variables: field, in, n, state, next, now, h, and the stages k1 to k16."
  (let ((names (loop for i from 1 to 16 collect (intern (format nil "K~d" i) :anmech))))
    `(with-control (,solver)
       (let ((stages (run-stages ,solver)))
         (declare (simple-vector stages))
         (let ((field (run-field ,solver)) (in (run-in ,solver)) (n (run-n ,solver))
               (state (run-state ,solver)) (next (run-next ,solver))
               (now (control time)) (h (control step))
               ,@(loop for name in names for i from 0 collect `(,name (aref stages ,i))))
           (declare (type (simple-array double-float (*)) in state next ,@names) (fixnum n) (double-float h now)
                    (type function field) (ignorable field in n state next h now ,@names))
           ,@body)))))

(defmacro combination (&rest weighted)
  "The sum of the (weight array) pairs at index i."
  `(flo (+ ,@(loop for (weight array) in weighted collect `(* ,weight (aref ,array i))))))

(defmacro stage (target fraction &rest weighted)
  "TARGET: the rates at time + FRACTION*h and state + h*(sum of WEIGHTED)."
  `(progn
     (for (i n)
       (setf (aref in i) (flo (+ (aref state i) (* h (combination ,@weighted))))))
     (setf (aref in n) (flo (+ now (* ,fraction h))))
     (funcall field in ,target)))

;;; One step

(defun try-step (solver)
  "Fill the stages k2 to k12 and the state at the end of the step, and estimate the error in units of the tolerance."
  (declare (type solver solver))
  (incf (run-evaluations solver) 11)
  (with-stages (solver)
    (stage k2 0.05260015195876773d0 (0.05260015195876773d0 k1))
    (stage k3 0.0789002279381516d0 (0.0197250569845379d0 k1) (0.0591751709536137d0 k2))
    (stage k4 0.1183503419072274d0 (0.02958758547680685d0 k1) (0.08876275643042054d0 k3))
    (stage k5 0.2816496580927726d0
           (0.2413651341592667d0 k1) (-0.8845494793282861d0 k3) (0.924834003261792d0 k4))
    (stage k6 0.3333333333333333d0
           (0.037037037037037035d0 k1) (0.17082860872947386d0 k4) (0.12546768756682242d0 k5))
    (stage k7 0.25d0
           (0.037109375d0 k1) (0.17025221101954405d0 k4) (0.06021653898045596d0 k5) (-0.017578125d0 k6))
    (stage k8 0.3076923076923077d0
           (0.03709200011850479d0 k1) (0.17038392571223998d0 k4) (0.10726203044637328d0 k5)
           (-0.015319437748624402d0 k6) (0.008273789163814023d0 k7))
    (stage k9 0.6512820512820513d0
           (0.6241109587160757d0 k1) (-3.3608926294469414d0 k4) (-0.868219346841726d0 k5) (27.59209969944671d0 k6)
           (20.154067550477894d0 k7) (-43.48988418106996d0 k8))
    (stage k10 0.6d0
           (0.47766253643826434d0 k1) (-2.4881146199716677d0 k4) (-0.590290826836843d0 k5) (21.230051448181193d0 k6)
           (15.279233632882423d0 k7) (-33.28821096898486d0 k8) (-0.020331201708508627d0 k9))
    (stage k11 0.8571428571428571d0
           (-0.9371424300859873d0 k1) (5.186372428844064d0 k4) (1.0914373489967295d0 k5) (-8.149787010746927d0 k6)
           (-18.52006565999696d0 k7) (22.739487099350505d0 k8) (2.4936055526796523d0 k9) (-3.0467644718982196d0 k10))
    (stage k12 1d0
           (2.273310147516538d0 k1) (-10.53449546673725d0 k4) (-2.0008720582248625d0 k5) (-17.9589318631188d0 k6)
           (27.94888452941996d0 k7) (-2.8589982771350235d0 k8) (-8.87285693353063d0 k9) (12.360567175794303d0 k10)
           (0.6433927460157636d0 k11))
    (let ((fifth 0d0) (third 0d0) (relative (control relative)) (absolute (run-absolute solver)))
      (declare (double-float fifth third relative) (type (simple-array double-float (*)) absolute))
      (for (i n)
        (let* ((slope (combination (0.054293734116568765d0 k1) (4.450312892752409d0 k6) (1.8915178993145003d0 k7)
                                   (-5.801203960010585d0 k8) (0.3111643669578199d0 k9) (-0.1521609496625161d0 k10)
                                   (0.20136540080403034d0 k11) (0.04471061572777259d0 k12)))
               (value (flo (+ (aref state i) (* h slope))))
               (unit (flo (max (+ (aref absolute i) (* relative (max (abs (aref state i)) (abs value)))) 1d-290)))
               (e3 (flo (/ (- slope (combination (0.244094488188976377952755905512d0 k1)
                                                 (0.733846688281611857341361741547d0 k9)
                                                 (0.0220588235294117647058823529412d0 k12)))
                           unit)))
               (e5 (flo (/ (combination (0.01312004499419488d0 k1) (-1.2251564463762044d0 k6)
                                        (-0.4957589496572502d0 k7) (1.6643771824549864d0 k8)
                                        (-0.35032884874997366d0 k9) (0.3341791187130175d0 k10)
                                        (0.08192320648511571d0 k11) (-0.022355307863886294d0 k12))
                           unit))))
          (declare (double-float slope value unit e3 e5))
          (setf (aref next i) value)
          (setq third (flo (+ third (* e3 e3)))
                fifth (flo (+ fifth (* e5 e5))))))
      (let ((both (flo (+ fifth (* 0.01d0 third)))))
        (declare (double-float both))
        (setf (control error)
              (if (> both 0d0)
                  (flo (/ (* (abs h) fifth) (sqrt (* both (+ 0d0 n)))))
                  (flo (* both 0d0))))))           ; 0, or NaN if the state is
    nil))

(defun load-end-of-step (solver)
  (with-stages (solver)
    (for (i n) (setf (aref in i) (aref next i)))
    (setf (aref in n) (flo (+ now h)))
    nil))

(defun finish-step (solver)
  "The rates at the end of the step, which begin the next one: k13."
  (load-end-of-step solver)
  (incf (run-evaluations solver))
  (with-stages (solver)
    (funcall field in k13)
    nil))

(defun dense-step (solver)
  "The array (time, step, coefficients) of the interpolant of order 7 over the step."
  (incf (run-evaluations solver) 3)
  (with-stages (solver)
    (let ((step (make-array (+ 2 (* 8 n)) :element-type 'double-float)))
      (declare (type (simple-array double-float (*)) step))
      (stage k14 0.1d0
             (0.056167502283047954d0 k1) (0.25350021021662483d0 k7) (-0.2462390374708025d0 k8)
             (-0.12419142326381637d0 k9) (0.15329179827876568d0 k10) (0.00820105229563469d0 k11)
             (0.007567897660545699d0 k12) (-0.008298d0 k13))
      (stage k15 0.2d0
             (0.03183464816350214d0 k1) (0.028300909672366776d0 k6) (0.053541988307438566d0 k7)
             (-0.05492374857139099d0 k8) (-0.00010834732869724932d0 k11) (0.0003825710908356584d0 k12)
             (-0.00034046500868740456d0 k13) (0.1413124436746325d0 k14))
      (stage k16 0.7777777777777778d0
             (-0.42889630158379194d0 k1) (-4.697621415361164d0 k6) (7.683421196062599d0 k7) (4.06898981839711d0 k8)
             (0.3567271874552811d0 k9) (-0.0013990241651590145d0 k13) (2.9475147891527724d0 k14)
             (-9.15095847217987d0 k15))
      (setf (aref step 0) now
            (aref step 1) h)
      (macrolet ((store (k form) `(setf (aref step (the fixnum (+ place ,k))) ,form)))
        (for (i n)
          (let* ((place (the fixnum (+ 2 (the fixnum (* 8 i)))))
                 (rise (flo (- (aref next i) (aref state i))))
                 (bend (flo (- (* h (aref k1 i)) rise))))
            (declare (fixnum place) (double-float rise bend))
            (store 0 (aref state i))
            (store 1 rise)
            (store 2 bend)
            (store 3 (flo (- rise (* h (aref k13 i)) bend)))
            (store 4 (flo (* h (combination
                                (-8.428938276109013d0 k1) (0.5667149535193777d0 k6) (-3.0689499459498917d0 k7)
                                (2.38466765651207d0 k8) (2.117034582445028d0 k9) (-0.871391583777973d0 k10)
                                (2.2404374302607883d0 k11) (0.6315787787694688d0 k12) (-0.08899033645133331d0 k13)
                                (18.148505520854727d0 k14) (-9.194632392478356d0 k15) (-4.436036387594894d0 k16)))))
            (store 5 (flo (* h (combination
                                (10.427508642579134d0 k1) (242.28349177525817d0 k6) (165.20045171727028d0 k7)
                                (-374.5467547226902d0 k8) (-22.113666853125306d0 k9) (7.733432668472264d0 k10)
                                (-30.674084731089398d0 k11) (-9.332130526430229d0 k12) (15.697238121770845d0 k13)
                                (-31.139403219565178d0 k14) (-9.35292435884448d0 k15) (35.81684148639408d0 k16)))))
            (store 6 (flo (* h (combination
                                (19.985053242002433d0 k1) (-387.0373087493518d0 k6) (-189.17813819516758d0 k7)
                                (527.8081592054236d0 k8) (-11.57390253995963d0 k9) (6.8812326946963d0 k10)
                                (-1.0006050966910838d0 k11) (0.7777137798053443d0 k12) (-2.778205752353508d0 k13)
                                (-60.19669523126412d0 k14) (84.32040550667716d0 k15) (11.99229113618279d0 k16)))))
            (store 7 (flo (* h (combination
                                (-25.69393346270375d0 k1) (-154.18974869023643d0 k6) (-231.5293791760455d0 k7)
                                (357.6391179106141d0 k8) (93.40532418362432d0 k9) (-37.45832313645163d0 k10)
                                (104.0996495089623d0 k11) (29.8402934266605d0 k12) (-43.53345659001114d0 k13)
                                (96.32455395918828d0 k14) (-39.17726167561544d0 k15) (-149.72683625798564d0 k16))))))))
      step)))

;;; Step control

(defconstant +damping+ 0.04d0 "How much the error of the step before counts (the PI controller's beta).")
(defconstant +exponent+ (- 0.125d0 (* 0.2d0 +damping+)))

(defmacro raised (base exponent)
  `(the double-float (#+gcl c-expt #-gcl expt (the (double-float 0d0) ,base) ,exponent)))

(defun advance (solver)
  "Take steps until the end, or something else that ends the run: the status. Conditions of the field pass through."
  (with-control (solver)
    (loop
      (let ((left (flo (- (control end) (control time)))))
        (declare (double-float left))
        (cond ((= left 0d0) (return :ok))
              ((>= (+ (run-accepted solver) (run-rejected solver)) (run-max-steps solver))
               (return :too-many-steps))
              ((<= (flo (abs left)) (flo (* 1.01d0 (abs (control step)))))
               (setf (control step) left))
              ((step-negligible-p solver) (return :step-too-small))
              ;; a step that the time can be moved by exactly: else time and state would part by roundings
              (t (setf (control step) (flo (- (+ (control time) (control step)) (control time))))))
        (try-step solver)
        (cond ((<= (control error) 1d0)
               (finish-step solver)
               (when (run-dense solver) (keep-step solver))
               (accept-step solver)
               (when (= (control step) left)
                 (setf (control time) (control end)))
               (choose-step solver)
               (let ((observer (run-observer solver)))
                 (when (and observer (eq :stop (funcall (the function observer) (run-in solver))))
                   (return :stopped))))
              (t (reject-step solver)))
        (when (run-progress solver) (report-progress solver))))))

(defun step-negligible-p (solver)
  (with-control (solver)
    (let ((size (flo (abs (control step)))))
      (declare (double-float size))
      (or (<= size (flo (* 2.3d-15 (abs (control time)))))
          (< size 1d-300)))))

(defun keep-step (solver)
  (push (dense-step solver) (run-steps solver))
  (load-end-of-step solver))

(defun accept-step (solver)
  "The end of the step becomes the beginning of the next one."
  (with-control (solver)
    (setf (control time) (flo (+ (control time) (control step)))))
  (incf (run-accepted solver))
  (setf (run-trouble solver) nil)
  (rotatef (run-state solver) (run-next solver))
  (let ((stages (run-stages solver)))
    (declare (simple-vector stages))
    (rotatef (aref stages 0) (aref stages 12))))

(defun choose-step (solver)
  "The next step after one that was accepted."
  (with-control (solver)
    (let* ((error (flo (max (control error) 1d-4)))
           (growth (flo (/ (* 0.9d0 (raised (control previous-error) +damping+)) (raised error +exponent+))))
           (limit (if (run-after-rejection solver) 1d0 6d0))
           (size (flo (min (* (abs (control step)) (min limit (max growth 0.333d0))) (control longest)))))
      (declare (double-float error growth limit size))
      (setf (control previous-error) error
            (control step) (flo (* size (control direction)))
            (run-after-rejection solver) nil))))

(defun reject-step (solver)
  (with-control (solver)
    (let ((error (control error)))
      (declare (double-float error))
      (cond ((< error 1d200)
             (shorten-step solver (flo (max 0.333d0 (/ 0.9d0 (raised error +exponent+))))))
            (t (setf (run-trouble solver) :not-finite)
               (shorten-step solver 0.25d0))))))

(defun shorten-step (solver factor)
  (with-control (solver)
    (setf (control step) (* (control step) factor)
          (run-after-rejection solver) t)
    (incf (run-rejected solver))))

(defun report-progress (solver)
  "Tell how far the run is, twice a second at most."
  (when (zerop (logand 63 (+ (run-accepted solver) (run-rejected solver))))
    (let ((clock (get-internal-real-time)))
      (when (> (- clock (run-progress-time solver)) (/ internal-time-units-per-second 2))
        (setf (run-progress-time solver) clock)
        (with-control (solver)
          (funcall (run-progress solver)
                   (/ (- (control time) (control start)) (- (control end) (control start)))))))))

;;; The first step

(defun weighted-norm (solver array)
  "The root mean square of ARRAY in units of the tolerance at the beginning of the step."
  (declare (type (simple-array double-float (*)) array))
  (with-stages (solver)
    (let ((sum 0d0) (absolute (run-absolute solver)) (relative (control relative)))
      (declare (double-float sum relative) (type (simple-array double-float (*)) absolute))
      (for (i n)
        (let ((ratio (flo (min 1d100
                               (/ (abs (aref array i))
                                  (max (+ (aref absolute i) (* relative (abs (aref state i)))) 1d-200))))))
          (declare (double-float ratio))
          (setq sum (flo (+ sum (* ratio ratio))))))
      (flo (sqrt (/ sum (+ 0d0 n)))))))

(defun guess-step (solver)
  "A first step from the size of the state, of its rates and of their change over a trial step of Euler's method."
  (with-control (solver)
    (let* ((size (weighted-norm solver (run-state solver)))
           (slope (weighted-norm solver (aref (run-stages solver) 0)))
           (trial (min (if (or (< size 1d-10) (< slope 1d-10)) 1d-6 (* 0.01d0 (/ size slope)))
                       (control longest))))
      (setf (control step) (* trial (control direction)))
      (let* ((change (handler-case (change-of-rates solver) ((or domain-violation arithmetic-error) () 0d0)))
             (largest (max slope (/ change trial)))
             (order-guess (cond ((not (< largest 1d200)) trial)         ; also if it is not finite
                                ((<= largest 1d-15) (max 1d-6 (* trial 1d-3)))
                                (t (raised (/ 0.01d0 largest) 0.125d0)))))
        (setf (control step)
              (* (control direction)
                 (min (control longest)
                      (max (min (* 100 trial) order-guess)
                           (* 1d-14 (abs (control time)))))))))))          ; what is seen of so late a time

(defun change-of-rates (solver)
  (incf (run-evaluations solver))
  (with-stages (solver)
    (stage k2 1d0 (1d0 k1))
    (for (i n) (setf (aref k3 i) (flo (- (aref k2 i) (aref k1 i))))))
  (weighted-norm solver (aref (run-stages solver) 2)))

;;; A run

(defun dop853 (field in n t1 &key (relative 1d-9) (absolute 1d-9) max-step (max-steps 10000000) observer dense progress)
  "Integrate FIELD from the state and time in IN to the time T1. IN holds N states, the time, and parameters of FIELD.
ABSOLUTE is a number, or an array with one for each state, which the observer may change on the way. OBSERVER, called
with IN after each step, may return :stop. DENSE keeps what DENSE-VALUE needs. PROGRESS is called now and then with
the part of the way that is done."
  (let* ((solver (make-run field in n t1 relative absolute max-step max-steps observer dense progress))
         (status (run-to-end solver)))
    (with-control (solver)
      (replace in (run-state solver) :end2 n)
      (setf (aref in n) (control time))
      (make-integration
       :steps (coerce (nreverse (run-steps solver)) 'simple-vector)
       :start (control start)
       :time (control time)
       :final (copy-seq (run-state solver))
       :accepted (run-accepted solver)
       :rejected (run-rejected solver)
       :evaluations (run-evaluations solver)
       :status status
       :message (status-message status solver)))))

(defun make-run (field in n t1 relative absolute max-step max-steps observer dense progress)
  (flet ((doubles (size) (make-array size :element-type 'double-float :initial-element 0d0)))
    (let* ((t0 (aref in n))
           (t1 (float t1 1d0))
           (longest (if max-step (min (float max-step 1d0) (abs (- t1 t0))) (abs (- t1 t0))))
           (stages (make-array 16))
           (tolerances (if (numberp absolute) (fill (doubles n) (float absolute 1d0)) absolute))
           (solver (make-solver :field field :in in :n n :state (doubles n) :next (doubles n) :stages stages
                                :control (doubles 9) :absolute tolerances :max-steps max-steps :observer observer
                                :dense dense :progress progress :progress-time (get-internal-real-time))))
      (dotimes (i 16) (setf (aref stages i) (doubles n)))
      (replace (run-state solver) in :end2 n)
      (with-control (solver)
        (setf (control time) t0
              (control start) t0
              (control end) t1
              (control direction) (if (< t1 t0) -1d0 1d0)
              (control relative) (float relative 1d0)
              (control longest) longest
              (control previous-error) 1d-4))
      solver)))

(defun run-to-end (solver)
  "Advance; a step in which the field leaves its domain or overflows is tried again with a shorter one. The status."
  (flet ((attempt (function)
           (handler-case (funcall function solver)
             (domain-violation (condition) (setf (run-trouble solver) condition) nil)
             (arithmetic-error () (setf (run-trouble solver) :not-finite) nil))))
    (with-control (solver)
      (if (= (control time) (control end))
          :ok
          (let ((status (and (attempt #'begin) (attempt #'advance))))
            (loop until (or status (zerop (control step)))
                  do (shorten-step solver 0.25d0)
                     (setq status (attempt #'advance)))
            (cond ((not (member status '(nil :step-too-small))) status)
                  ((null (run-trouble solver)) :step-too-small)
                  ((eq :not-finite (run-trouble solver)) :not-finite)
                  (t :domain)))))))

(defun begin (solver)
  "The first rates and the first step."
  (incf (run-evaluations solver))
  (let ((rates (aref (run-stages solver) 0)))
    (funcall (the function (run-field solver)) (run-in solver) rates)
    (unless (every (lambda (rate) (<= (abs rate) most-positive-double-float)) rates)
      (error 'arithmetic-error))
    (guess-step solver)
    t))

(defun status-message (status solver)
  (let ((time (maxima-text (with-control (solver) (control time)))))
    (ecase status
      ((:ok :stopped) nil)
      (:too-many-steps (format nil "~d steps were not enough: the motion was followed to time ~a"
                               (run-max-steps solver) time))
      (:step-too-small (format nil "the step became too small at time ~a: the motion has a singularity there, or no ~
                                    double is as accurate as it was asked to be" time))
      (:not-finite (format nil "the rates grow without bound at time ~a" time))
      (:domain (format nil "the motion ends at time ~a: ~a" time (run-trouble solver))))))

;;; Dense output

(defun dense-value (integration time out)
  "Write the state at TIME to OUT. The integration was made with :dense t; TIME is between its ends."
  (let* ((steps (integration-steps integration))
         (time (float time 1d0))
         (low 0)
         (high (1- (length steps)))
         (forward (>= (integration-time integration) (integration-start integration))))
    (loop while (< low high)
          do (let ((middle (ceiling (+ low high) 2)))
               (if (if forward
                       (<= (aref (the double-array (svref steps middle)) 0) time)
                       (>= (aref (the double-array (svref steps middle)) 0) time))
                   (setq low middle)
                   (setq high (1- middle)))))
    (if (minusp high)
        (replace out (integration-final integration))
        (funcall (integration-interpolant integration) (svref steps low) time out
                 (length (integration-final integration))))
    out))

(defun interpolate (step time out n)
  (declare (type (simple-array double-float (*)) step out) (double-float time) (fixnum n))
  (with-fast-arithmetic
    (let* ((s (flo (/ (- time (aref step 0)) (aref step 1))))
           (r (flo (- 1d0 s))))
      (declare (double-float s r))
      (for (i n)
        (let ((place (the fixnum (+ 2 (the fixnum (* 8 i))))))
          (declare (fixnum place))
          (macrolet ((part (k) `(aref step (the fixnum (+ place ,k)))))
            (setf (aref out i)
                  (flo (+ (part 0)
                          (* s (+ (part 1)
                                  (* r (+ (part 2)
                                          (* s (+ (part 3)
                                                  (* r (+ (part 4)
                                                          (* s (+ (part 5)
                                                                  (* r (+ (part 6) (* s (part 7))))))))))))))))))))
      nil)))
